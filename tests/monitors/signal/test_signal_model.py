"""Signals beside models in plain NumPy: random courses, the same verdict at the same frame.

With a debounce of half a period a test's verdict is there before the next frame comes.
"""

import numpy as np
import pytest
from amount import amount, examples
from car import Car, write
from hypothesis import given, settings
from hypothesis import strategies as st

PERIOD_S = 0.01
DBC = (
    'BO_ 256 Wheel: 8 A\n SG_ Speed : 0|16@1- (0.01,0) [-300|300] "km/h" B\n SG_ Gear : 16|8@1+ (1,0) [0|255] "" B\n'
    'BO_ 257 Body: 8 A\n SG_ Moving : 0|16@1- (0.1,0) [0|0] "km/h" B\n'
    'BO_ 258 Pages: 8 A\n SG_ Page M : 0|8@1+ (1,0) [0|0] "" B\n SG_ One m1 : 8|8@1+ (1,0) [0|0] "" B\n'
    ' SG_ Two m2 : 8|8@1+ (1,0) [0|0] "" B\n'
    'VAL_ 256 Gear 0 "Park" 1 "Drive" 2 "Reverse" 15 "SNA" ;\n'
)
SHORT = "failed_ms = 5.0, passed_ms = 5.0"


def car(folder, signal):
    text = f'[[monitor]]\nname = "w"\ntype = "signal"\nsignal = [{{ {signal}, {SHORT} }}]\n'
    return Car(write(folder, DBC, text), PERIOD_S * 1e3)


def wheel(hundredths, gear=0):
    return int(hundredths).to_bytes(2, "little", signed=True) + bytes([gear, 0, 0, 0, 0, 0])


def states(made, kind, slots):
    """Return the verdict of a kind of fault before the slot after each of some: slot k begins at k periods."""
    told = [e for e in made.of("dtc") if e["fault"].endswith(f".{kind}")]
    changes = {int(e["t_ns"] // round(PERIOD_S * 1e9)): bool(e["status"] & 1) for e in told}
    state, found = False, []
    for slot in range(1, max(slots) + 1):
        state = changes.get(slot, state)
        if slot in slots:
            found.append(state)
    return found


def held(model):
    """Return a model's verdicts; where it has none the one before holds."""
    state, found = False, []
    for verdict in model:
        state = state if verdict is None else bool(verdict)
        found.append(state)
    return found


def compare(made, kind, model, slots):
    assert states(made, kind, slots)[:-1] == held(model)[:-1]


def stuck(x, by, seconds, known=None):
    """Model of stuck by time: so long within ``by`` of where it last moved to. A move passes, before it is open."""
    told, anchor, still = [], None, 0.0
    for k, value in enumerate(x):
        if known is not None and not known[k]:
            anchor = None
            told.append(None)
            continue
        moved = anchor is None or abs(value - anchor) > by
        verdict = False if moved and anchor is not None else None
        anchor, still = (value, 0.0) if moved else (anchor, still + PERIOD_S)
        told.append(True if still >= seconds else verdict)
    return told


STEPS = st.lists(st.sampled_from([-40, -3, -1, 0, 0, 0, 0, 0, 1, 2, 40]), min_size=30, max_size=120)


@pytest.mark.long
@settings(max_examples=examples(40), deadline=None)
@given(STEPS, st.integers(0, 5), st.integers(1, 20))
def test_stuck_by_time(tmp_path_factory, steps, by, frames):
    x = np.cumsum(steps)
    limits = f"stuck = {{ seconds = {(frames - 0.5) * PERIOD_S}, by = {(by + 0.5) / 100} }}"
    made = car(tmp_path_factory.mktemp("s"), f'signal = "Wheel.Speed", {limits}').feed([wheel(value) for value in x])
    compare(made, "stuck", stuck(x, by + 0.5, (frames - 0.5) * PERIOD_S), range(1, len(x) + 1))


@pytest.mark.long
@settings(max_examples=examples(40), deadline=None)
@given(STEPS, st.data())
def test_stuck_while_another_signal_says_so(tmp_path_factory, steps, data):
    """Frames of both signals take turns: what the other one says is what it said last."""
    x = np.cumsum(steps)
    by_time = data.draw(st.booleans())
    drawn = data.draw(st.lists(st.sampled_from([-20, 2, 2, 2, 5, 30]), min_size=len(x), max_size=len(x)))
    other = np.asarray(drawn) if by_time else np.cumsum(drawn)
    if by_time:
        asked = 'seconds = 0.105, during = "Body.Moving", within = [0.05, 1000]'
        # Two periods go by from one frame of the signal to the next.
        model, anchor, still = [], None, 0.0
        for value, moving in zip(x, other, strict=True):
            moved = anchor is None or abs(value - anchor) > 0.5
            verdict = False if moved and anchor is not None and moving >= 1 else None
            if moved:
                anchor, still = value, 0.0
            else:
                still = still + 2 * PERIOD_S if moving >= 1 else 0.0
            model.append(True if still >= 0.105 else verdict)
    else:
        asked = 'moving = "Body.Moving", moving_by = 4.95'
        model, anchor, then = [], None, 0
        for value, moving in zip(x, other, strict=True):
            moved = anchor is None or abs(value - anchor) > 0.5
            verdict = False if moved and anchor is not None else None
            if moved:
                anchor, then = value, moving
            model.append(True if abs(moving - then) >= 49.5 else verdict)
    made = car(tmp_path_factory.mktemp("s"), f'signal = "Wheel.Speed", stuck = {{ {asked}, by = 0.005 }}')
    for value, moving in zip(x, other, strict=True):
        made.feed([int(moving).to_bytes(2, "little", signed=True) + bytes(6)], can_id=0x101)
        made.feed([wheel(value)])
    compare(made, "stuck", model, range(2, 2 * len(x) + 1, 2))


@pytest.mark.long
@settings(max_examples=examples(40), deadline=None)
@given(st.lists(st.sampled_from([0, *[2] * 8, 7, 15, 255]), min_size=30, max_size=80), st.integers(1, 6))
def test_values_that_are_none(tmp_path_factory, gears, frames):
    seconds = (frames - 0.5) * PERIOD_S
    asked = f"undefined = true, all_ones = true, stuck = {{ seconds = {seconds} }}, plausible = [0, 1.5]"
    made = car(tmp_path_factory.mktemp("s"), f'signal = "Wheel.Gear", {asked}').feed([wheel(0, gear) for gear in gears])
    x = np.asarray(gears)
    slots = range(1, len(x) + 1)

    def first_is_none(model):
        """How often it comes is not known then: what fails in it alone is not tested any more when none follows."""
        return [None, *model[1:]]

    compare(made, "invalid", first_is_none(x == 15), slots)
    compare(made, "all_ones", first_is_none(x == 255), slots)
    compare(made, "undefined", first_is_none(x == 7), slots)
    known = x < 3
    compare(made, "stuck", stuck(x, 0.0, seconds, known=known), slots)
    compare(made, "high", first_is_none([None if not known[k] else x[k] > 1.5 for k in range(len(x))]), slots)


@pytest.mark.long
@settings(max_examples=examples(40), deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from([0, 1, 1, 2, 2, 3]), st.sampled_from([1, 1, 1, 1, 2, 9])), min_size=20, max_size=80
    )
)
def test_missing_while_its_message_comes(tmp_path_factory, course):
    """Pages in a random order, a random number of periods apart; an unknown page is one without the signal."""
    made = car(tmp_path_factory.mktemp("s"), f'signal = "Pages.Two", missing_ms = {4.5 * PERIOD_S * 1e3}')
    model, slots, away, last = [], [], 0.0, None
    for page, pause in course:
        made.t_ns += round((pause - 1) * PERIOD_S * 1e9)
        made.feed([bytes([page, 5, 0, 0, 0, 0, 0, 0])], can_id=0x102)
        slot = round(made.t_ns / (PERIOD_S * 1e9))
        slots.append(slot)
        seconds = 0.0 if last is None else (slot - last) * PERIOD_S
        away = 0.0 if page == 2 or seconds >= 4.5 * PERIOD_S else away + seconds
        last = slot
        model.append(False if page == 2 else True if away >= 4.5 * PERIOD_S else None)
    compare(made, "missing", model, slots)


GATED = {
    "stuck by time": 'stuck = { seconds = 0.055, by = 0.005, during = "Body.Moving", within = [5, 1000] }',
    "stuck by share": 'stuck = { seconds = 0.05, share = 0.5, during = "Body.Moving", within = [5, 1000] }',
    "stuck inside": "stuck = { seconds = 0.055, by = 0.005, inside = [-2, 2] }",
    "relation": "",
}


@pytest.mark.parametrize("kind", GATED)
@pytest.mark.parametrize("seed", range(amount(10, 2)))
def test_while_a_gate_is_shut_nothing_passes_fails_or_counts(tmp_path, kind, seed):
    """What failed stays, what passed does, and time that goes by decides nothing."""
    rng = np.random.default_rng(seed)
    times = "failed_ms = 25.0, passed_ms = 25.0"
    signal = f'type = "signal"\nsignal = [{{ signal = "Wheel.Speed", {GATED[kind]}, {times} }}]'
    rule = (
        f'type = "rule"\nrule = [{{ name = "r", holds = "abs(Wheel.Speed) < 2", when = "Body.Moving > 5", {times} }}]'
    )
    text = f'[[monitor]]\nname = "w"\n{signal if GATED[kind] else rule}\n'
    made = Car(write(tmp_path, DBC, text), PERIOD_S * 1e3)
    told = []
    for _ in range(90):
        shut, moves, far = rng.random(3) < (0.5, 0.5, 0.5)
        made.feed([(0 if shut else 100).to_bytes(2, "little") + bytes(6)], can_id=0x101)
        if kind == "stuck inside":
            levels = (300, 310) if shut else (0, 10)
        else:
            levels = (300, 310) if far else (0, 10)
        made.feed([wheel(levels[k % 2 if moves else 0]) for k in range(1)])  # what the gate says now has come
        before = len(made.events)
        fdc = _counts(made)
        made.feed([wheel(levels[k % 2 if moves else 0]) for k in range(int(rng.choice([1, 2, 8, 20])))])
        after = [e for e in made.events[before:] if e["event"] in ("monitor", "dtc")]
        told += [bool(e.get("status", 0) & 1) for e in after if e["event"] == "dtc"]
        if shut:
            assert [e for e in after if e.get("result") != "not tested"] == [], f"seed {seed}"
            assert _counts(made) == fdc, f"seed {seed}"
    assert {True, False} <= set(told), "while it is open both come"


def _counts(made):
    return [made.gateway.engine.fault_detection_counter(k) for k in range(len(made.gateway.engine.faults))]
