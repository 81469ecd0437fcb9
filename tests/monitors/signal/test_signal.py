"""Limits of any signal: each kind beside a model in plain NumPy, what the database says, what is refused."""

import numpy as np
import pytest
from amount import amount
from car import Car, write

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.errors import InputError, InputErrors

DBC = (
    'BO_ 256 Wheel: 8 A\n SG_ Speed : 0|16@1- (0.01,0) [-300|300] "km/h" B\n SG_ Gear : 16|8@1+ (1,0) [0|255] "" B\n'
    'BO_ 257 Body: 8 A\n SG_ Moving : 0|16@1- (0.1,0) [0|0] "km/h" B\n'
    'VAL_ 256 Gear 0 "Park" 1 "Drive" 2 "Reverse" 15 "SNA" ;\n'
)
NOW = "failed_ms = 1.0, passed_ms = 1.0"


def monitor(*signals):
    listed = "".join(f"    {{ {signal} }},\n" for signal in signals)
    return f'[[monitor]]\nname = "w"\ntype = "signal"\nsignal = [\n{listed}]\n'


def car(folder, *signals, more="", period_ms=10.0):
    return Car(write(folder, DBC, monitor(*signals) + more), period_ms)


def frames(speeds, gears=None):
    gears = [0] * len(speeds) if gears is None else gears
    return [
        round(speed * 100).to_bytes(2, "little", signed=True) + bytes([gear, 0, 0, 0, 0, 0])
        for speed, gear in zip(speeds, gears, strict=True)
    ]


def hysteresis(over, width):
    state, told = False, []
    for x in over:
        if x > 0:
            state = True
        elif x < -width or width == 0:
            state = False
        told.append(state)
    return told


def case(kind, x, rng):
    """Return the limits to ask for, and what the model says of each sample."""
    limit = float(np.quantile(np.abs(x), 0.7))
    width = min(float(rng.choice([0.0, 2.0])), limit / 2)
    if kind == "gradient":
        rate = np.abs(np.diff(x)) / 0.01
        limit = float(np.quantile(rate, 0.9)) + 0.5
        return f"gradient = {limit}", [False, None, *(rate > limit)[1:]]  # how often it comes is not known at first
    if kind == "noise":
        return "noise = { deviation = 1.73, samples = 20 }", scatter(x, 20, 1.73)
    table = "electrical" if kind in ("below", "above") else "plausible"
    over = x - limit if kind in ("above", "high") else -limit - x
    return f"{table} = [{-limit}, {limit}], hysteresis = {width}", hysteresis(over, width)


@pytest.mark.parametrize("kind", ["below", "above", "low", "high", "gradient", "noise"])
def test_random_courses_beside_a_model_in_numpy(tmp_path, kind):
    """With a debounce of half a period a test's verdict is there before the next frame comes."""
    for seed in range(amount(20, 4, 2)):
        print("seed", seed)
        rng = np.random.default_rng([seed, len(kind)])
        x = np.round(np.cumsum(rng.normal(0, 3, 400)), 2)
        asked, model = case(kind, x, rng)
        made = car(tmp_path, f'signal = "Wheel.Speed", {asked}, failed_ms = 5.0, passed_ms = 5.0').feed(frames(x))
        told = [e for e in made.of("dtc") if e["fault"].endswith(kind)]
        changes = {int(e["t_ns"] // 10_000_000): bool(e["status"] & 1) for e in told}
        state = False
        for k, failed in enumerate(model[:-1], 1):
            state = changes.get(k, state)
            assert failed is None or state == failed, f"frame {k}, seed {seed}"


def scatter(x, samples, deviation):
    """Model of the scatter: None while there are too few samples."""
    mean, told = 0.0, []
    for k in range(len(x)):
        if k >= 2:
            second = x[k] - 2 * x[k - 1] + x[k - 2]
            mean += max(1 / samples, 1 / (k - 1)) * (second * second / 6 - mean)
        told.append(None if k <= samples else bool(np.sqrt(mean) > deviation))
    return told


def test_a_gap_in_a_smooth_course_is_no_noise(tmp_path):
    """Frames that nobody heard: the course has gone on; and noise after a gap is told all the same."""
    asked = f'signal = "Wheel.Speed", noise = {{ deviation = 2.0, samples = 20 }}, {NOW}'
    t = np.arange(1000) * 0.01
    smooth = np.round(50 * np.sin(2 * np.pi * t / 4), 2)
    made = car(tmp_path, asked)
    made.feed(frames(smooth[t < 1.5]))
    made.t_ns += 1_500_000_000
    made.feed(frames(smooth[t >= 3.0]))
    assert made.failed() == []
    made.t_ns += 1_500_000_000
    rough = np.round(smooth + np.random.default_rng(3).normal(0, 6, len(smooth)), 2)
    made.feed(frames(rough[:100]))
    assert made.failed() == ["Speed.noise"]


STEEP = """gradient = 20, plausible = [0, 100]"""


@pytest.mark.parametrize("period_ms", [10.0, 100.0, 300.0])
def test_one_odd_frame_and_silence_is_no_fault_of_the_sensor(tmp_path, period_ms):
    """That nothing comes any more says nothing of the value: not tested; where it goes on, it counts as ever."""
    odd = frames([50.0] * 20 + [150.0])
    made = car(tmp_path, f'signal = "Wheel.Speed", {STEEP}', period_ms=period_ms).feed(odd)
    made.gateway.advance(made.t_ns + 10_000_000_000)
    assert made.failed() == []
    made = car(tmp_path, f'signal = "Wheel.Speed", {STEEP}', period_ms=period_ms).feed(odd)
    made.feed(frames([150.0] * round(600 / period_ms)))
    assert made.failed() == ["Speed.high"]


def test_a_first_frame_alone_is_no_fault_of_the_sensor(tmp_path):
    made = car(tmp_path, f'signal = "Wheel.Speed", {STEEP}').feed(frames([150.0]))
    made.gateway.advance(made.t_ns + 10_000_000_000)
    assert made.failed() == []


def test_frames_that_come_together_change_no_faster(tmp_path):
    """An adapter hands two frames over 32 us apart: the value was sampled a period apart; or as long as one says."""
    for more, found in (("", []), (", least_step_ms = 5", []), (", least_step_ms = 0.01", ["Speed.gradient"])):
        made = car(tmp_path, f'signal = "Wheel.Speed", gradient = 20, {NOW}{more}')
        made.feed(frames(np.arange(50) * 0.06))
        made.t_ns -= 9_968_000
        made.feed(frames(3.0 + np.arange(50) * 0.06))
        assert made.failed() == found, more


def test_a_broken_wire_is_one_fault(tmp_path):
    made = car(tmp_path, f'signal = "Wheel.Speed", electrical = [-250, 250], plausible = [-200, 200], {NOW}')
    made.feed(frames([10.0] * 20 + [300.0] * 20))
    assert made.failed() == ["Speed.above"]


def test_stuck_by_time_while_another_signal_is_in_a_range(tmp_path):
    made = car(
        tmp_path,
        'signal = "Wheel.Speed", stuck = { seconds = 0.5, by = 0.05, during = "Body.Moving", within = [5, 1000] }, '
        + NOW,
    )
    still = frames([10.0] * 100)
    made.feed(still)
    assert made.failed() == [], "the car stands"
    made.feed([(100).to_bytes(2, "little") + bytes(6)], can_id=0x101)
    made.feed(still[:40])
    assert made.failed() == []
    made.feed(still)
    assert made.failed() == ["Speed.stuck"]
    made.feed(frames([11.0, 12.0, 13.0]))
    assert not made.of("dtc")[-1]["status"] & 1


def test_time_counts_only_while_the_other_signal_is_in_its_range(tmp_path):
    stuck = '{ seconds = 0.5, during = "Body.Moving", within = [5, 1000] }'
    made = car(tmp_path, f'signal = "Wheel.Speed", stuck = {stuck}, {NOW}')
    for moving in (100, 0, 100, 0, 100):  # 10 km/h, or stands
        made.feed([moving.to_bytes(2, "little") + bytes(6)], can_id=0x101)
        made.feed(frames([10.0] * (40 if moving else 5)))
    assert made.failed() == [], "never half a second at once"


def test_stuck_by_time_alone(tmp_path):
    made = car(tmp_path, f'signal = "Wheel.Speed", stuck = {{ seconds = 0.5, by = 0.06 }}, {NOW}')
    made.feed(frames([10.0, 10.05] * 24))
    assert made.failed() == []
    made.feed(frames([10.0] * 10))
    assert made.failed() == ["Speed.stuck"]
    assert not made.feed(frames([10.2] * 3)).of("dtc")[-1]["status"] & 1


def test_a_signal_at_the_end_of_its_range_is_not_tested_for_standing(tmp_path):
    stuck = "{ seconds = 0.5, inside = [0.5, 99.5] }"
    made = car(tmp_path, f'signal = "Wheel.Speed", stuck = {stuck}, failed_ms = 200.0, passed_ms = 1.0')
    made.feed(frames([0.0] * 100 + [99.5] * 100))
    assert made.failed() == []
    assert made.gateway.memory.status("w.Speed.stuck") & 0x40, "not tested"
    made.feed(frames([50.0] * 60 + [0.0] * 100))
    assert made.failed() == [], "it failed for less than failed_ms"
    made.feed(frames([50.0] * 80))
    assert made.failed() == ["Speed.stuck"]
    made.feed(frames([0.0] * 100))
    assert made.of("dtc")[-1]["status"] & 1, "what was not tested does not heal"
    assert not made.feed(frames([3.0, 4.0, 5.0])).of("dtc")[-1]["status"] & 1


def test_what_another_signal_says_is_waited_for(tmp_path):
    stuck = '{ moving = "Body.Moving", moving_by = 8.0 }'
    made = car(tmp_path, f'signal = "Wheel.Speed", stuck = {stuck}, {NOW}')
    made.feed(frames([10.0] * 50))
    assert made.gateway.memory.status("w.Speed.stuck") & 0x40, "not tested: the other one never came"
    assert not any(e["value"] != e["value"] for e in made.of("monitor")), "no NaN is told"


def test_stuck_while_another_signal_moves(tmp_path):
    made = car(tmp_path, f'signal = "Wheel.Speed", stuck = {{ moving = "Body.Moving", moving_by = 8.0 }}, {NOW}')
    for k in range(60):
        made.feed([(k * 10).to_bytes(2, "little") + bytes(6)], can_id=0x101)
        made.feed(frames([k / 10]))
    assert made.failed() == [], "both move"
    for k in range(60, 80):
        made.feed([(k * 10).to_bytes(2, "little") + bytes(6)], can_id=0x101)
        made.feed(frames([5.9]))
    assert made.failed() == ["Speed.stuck"]


def test_invalid_codes_come_from_the_texts_and_end_all_other_tests(tmp_path):
    made = car(tmp_path, f'signal = "Wheel.Gear", plausible = [0, 5], undefined = true, all_ones = true, {NOW}')
    made.feed(frames([0.0] * 20, [1] * 10 + [15] * 10))
    assert made.failed() == ["Gear.invalid"]
    made.feed(frames([0.0] * 20, [1] * 10 + [7] * 10))
    assert made.failed() == ["Gear.invalid", "Gear.undefined"]
    made.feed(frames([0.0] * 20, [1] * 10 + [255] * 10))
    assert made.failed() == ["Gear.invalid", "Gear.undefined", "Gear.all_ones"]


PAGES = (
    'BO_ 256 Pages: 8 A\n SG_ Page M : 0|8@1+ (1,0) [0|0] "" B\n SG_ Always : 32|8@1+ (1,0) [0|0] "" B\n'
    ' SG_ Outer m1M : 8|8@1+ (1,0) [0|0] "" B\n SG_ Plain m0 : 8|8@1+ (1,0) [0|0] "" B\n'
    ' SG_ Inner m7 : 16|8@1+ (1,0) [0|0] "" B\n SG_ Other m8 : 16|8@1+ (1,0) [0|0] "" B\n'
    "SG_MUL_VAL_ 256 Outer Page 1-1;\nSG_MUL_VAL_ 256 Plain Page 0-0;\n"
    "SG_MUL_VAL_ 256 Inner Outer 7-7, 9-12;\nSG_MUL_VAL_ 256 Other Outer 8-8;\n"
)
PLAIN, INNER, OTHER = (bytes([*page, 0, 0, 0, 0, 0]) for page in ((0, 7, 3), (1, 11, 3), (1, 8, 3)))


def pages(folder, signal):
    return Car(write(folder, PAGES, monitor(signal)))


def test_a_multiplexed_signal_that_its_message_comes_without(tmp_path):
    made = pages(tmp_path, 'signal = "Pages.Inner", missing_ms = 500')
    made.feed([PLAIN, INNER, OTHER] * 40)
    assert made.failed() == []
    made.feed([PLAIN, OTHER] * 24)
    assert made.failed() == [], "0.48 s"
    made.feed([OTHER, PLAIN] * 2)
    assert made.failed() == ["Inner.missing"]
    told = made.of("dtc")[-1]["evidence"]
    assert (told["away [s]"], told["threshold"]) == (pytest.approx(0.5), pytest.approx(0.5))
    assert not made.feed([INNER]).of("dtc")[-1]["status"] & 1, "one that has it ends it"


def test_a_multiplexed_signal_that_never_came(tmp_path):
    assert pages(tmp_path, 'signal = "Pages.Inner", missing_ms = 500').feed([PLAIN] * 60).failed() == ["Inner.missing"]


def test_nothing_is_missing_while_the_whole_message_is_away(tmp_path):
    made = pages(tmp_path, 'signal = "Pages.Inner", missing_ms = 500')
    made.feed([INNER, *[PLAIN] * 40])
    made.t_ns += 10_000_000_000
    made.feed([PLAIN] * 40)
    assert made.failed() == [], "0.4 s before and 0.4 s after it"
    assert made.feed([PLAIN] * 15).failed() == ["Inner.missing"]


def test_a_multiplexed_signal_is_looked_at_in_the_frames_that_have_it(tmp_path):
    """Its value of a second before is not one that stands still, nor one that is still too high."""
    asked = 'signal = "Pages.Inner", stuck = { seconds = 0.5 }, gradient = 40.0, failed_ms = 1.0, passed_ms = 1.0'
    made = pages(tmp_path, asked)
    moving = [[INNER[:2] + bytes([k]) + INNER[3:], *[PLAIN] * 9] for k in range(0, 60, 3)]
    made.feed([frame for some in moving for frame in some])
    assert made.failed() == [], "30 per second, not 300; it moves each time it comes"
    made.feed([moving[-1][0], *[PLAIN] * 9] * 7)
    assert made.failed() == ["Inner.stuck"]


def test_dtcs_are_the_signal_s_own_and_stay_when_others_come(tmp_path):
    def codes(*signals):
        gateway = Gateway(load_config(write(tmp_path, DBC, monitor(*signals))))
        return {definition.id: str(definition.dtc) for definition in gateway.catalogue}

    one = codes('signal = "Wheel.Speed", plausible = [0, 1]')
    both = codes('signal = "Wheel.Gear", undefined = true', 'signal = "Wheel.Speed", plausible = [0, 1]')
    assert one.items() <= both.items()
    assert {code[-2:] for code in one.values()} >= {"84", "85"}
    own = codes('signal = "Wheel.Speed", plausible = [0, 1], code = "C0035"')
    assert own["w.Speed.high"] == "C0035-85"


def test_more_signals_than_a_part_has_room_for(tmp_path):
    many = "".join(f' SG_ S{k} : {k}|1@1+ (1,0) [0|0] "" B\n' for k in range(30))
    text = monitor(*(f'signal = "Many.S{k}", plausible = [0, 0.5], {NOW}' for k in range(30)))
    made = Car(write(tmp_path, f"BO_ 256 Many: 8 A\n{many}", text))
    made.feed([(1 << 29 | 1).to_bytes(8, "little")] * 10)
    assert made.failed() == ["S0.high", "S29.high"]
    # What fails in a first frame is looked at again in two of the parts: no other one may come.
    assert made.gateway.engine.readout()["w"]["steps"] == 30 + 2, "three parts, which people see as one"


@pytest.mark.parametrize(
    ("signal", "said"),
    [
        (
            'signal = "Wheel.Sped", plausible = [0, 1]',
            r"monitor.0..signal.0..signal = 'Wheel.Sped': .*did you mean Speed",
        ),
        ('signal = "Wheel.Speed"', "nothing is asked of it"),
        ('signal = "Wheel.Speed", plausible = [1, 0]', "the least value is below the greatest"),
        ('signal = "Wheel.Speed", plausible = [0, 1], least_step_ms = 5', "least_step_ms goes with a gradient"),
        ('signal = "Wheel.Speed", undefined = true', "the database gives its values no texts"),
        ('signal = "Wheel.Gear", invalid = ["SNAA"]', "no value of Wheel.Gear has this text; did you mean SNA"),
        ('signal = "Wheel.Speed", plausible = [0, 1], hysteresis = 1', "less than half of plausible"),
        ('signal = "Wheel.Speed", stuck = { seconds = 1, during = "Body.Moving" }', "during and within"),
        ('signal = "Wheel.Speed", stuck = { seconds = 1, inside = [2, 1] }', "inside: the least"),
        ('signal = "Wheel.Speed", missing_ms = 100', "this signal is in every frame of its message; timeout_ms"),
        (
            'signal = "Wheel.Speed", stuck = { seconds = 1, during = "Body.Movin", within = [0, 1] }',
            r"monitor.0..signal.0..stuck.during = 'Body.Movin': .*did you mean Moving",
        ),
        ('signal = "Wheel.Speed", gradiant = 3', "did you mean gradient"),
    ],
)
def test_mistakes_are_one_line(tmp_path, signal, said):
    with pytest.raises((InputError, InputErrors), match=said) as told:
        Gateway(load_config(write(tmp_path, DBC, monitor(signal))), file=tmp_path / "gateway.toml")
    (line,) = str(told.value).splitlines()
    assert "gateway.toml" in line


def test_a_reload_keeps_what_is_known_of_signals_whose_limits_are_as_before(tmp_path):
    """A signal of another message that comes first does not take the place of the one that was there."""
    one = f'signal = "Wheel.Speed", stuck = {{ seconds = 0.5 }}, {NOW}'
    before = car(tmp_path, one).feed(frames([10.0] * 40))
    before.gateway.finish(before.t_ns)
    path = write(tmp_path, DBC, monitor('signal = "Body.Moving", plausible = [0, 9]', one))
    after = Gateway(load_config(path), file=path, store=before.gateway.store)
    after.succeed(before.gateway)
    before.gateway = after
    before.feed(frames([10.0] * 15))
    assert before.failed() == ["Speed.stuck"], "0.4 s before the reload and 0.15 s after it"


def test_a_share_of_values_must_move_so_that_frames_that_come_twice_are_seen(tmp_path):
    stuck = '{ seconds = 0.5, share = 0.6, during = "Body.Moving", within = [5, 1000] }'
    made = car(tmp_path, f'signal = "Wheel.Speed", stuck = {stuck}, {NOW}')
    moves = [10.0 + 0.01 * (k % 7) for k in range(300)]
    made.feed(frames([10.0] * 200))
    assert made.failed() == [], "the car stands"
    made.feed([(100).to_bytes(2, "little") + bytes(6)], can_id=0x101)
    made.feed(frames(moves))
    assert made.failed() == []
    made.feed(frames([moves[k - k % 2] for k in range(300)]))
    assert made.failed() == ["Speed.stuck"], "each second frame as the one before: half of them move"
    made.feed(frames(moves))
    assert not made.of("dtc")[-1]["status"] & 1
