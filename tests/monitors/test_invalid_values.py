"""NaN, infinities and absurd magnitudes in any input of any monitor: no state is poisoned, nobody is accused."""

import numpy as np
import pytest
from float_twin import spoiled, twin

from gateway.engine.events import QUALIFIED_FAILED
from gateway_fdi.jit import COMPILED

#: Scenario and how long it is played [s].
SCENARIOS = {
    "crank_healthy": 2.0,
    "pedal_healthy": 2.0,
    "pedal_three": 2.0,
    "steering_healthy": 2.0,
    "linear_aircraft_healthy": 8.0,
    "linear_belt_faults": 8.0,
    "truck_healthy": 12.0,
}
VALUES = (np.nan, np.inf, -np.inf, 3e38, -1e300, 1e16)
SEED = 20261122
#: Plain Python takes hundreds of times as long: one of the inputs, for a part of the time.
PLACES, SHARE = (1000, 1.0) if COMPILED else (1, 0.1)


@pytest.fixture(scope="module", params=SCENARIOS)
def case(request, tmp_path_factory):
    seconds = SHARE * SCENARIOS[request.param]
    return twin(request.param, seconds, tmp_path_factory.mktemp("twin"))


def places_of(case, rng):
    """Return the signals to spoil, each as message and name."""
    places = list(case.places)
    order = rng.permutation(len(places))[:PLACES]
    return [places[k] for k in sorted(order)]


def run(twin_, frames):
    """Return the engine, the faults that qualified, and the floats of the states that are not finite."""
    engine = twin_.engine()
    failed = set()

    def sink(events):
        failed.update(int(e["fault"]) for e in events if e["kind"] == QUALIFIED_FAILED)

    for k in range(0, len(frames), 500):
        engine.process(frames[k : k + 500], sink)
    bad = set()
    for k in range(len(engine.monitors)):
        bad |= {(k, path) for path in not_finite(engine.state_of(k)[0])}
    return engine, failed, bad


def not_finite(value, path=""):
    """Yield the paths of floats in a record that are not finite."""
    dtype = value.dtype
    if dtype.names:
        for name in dtype.names:
            yield from not_finite(value[name], f"{path}.{name}")
    elif dtype.kind == "f" and not np.isfinite(value).all():
        yield path


def test_the_twin_is_healthy_and_steps_every_monitor(case):
    engine, failed, _ = run(case, case.frames)
    assert not failed
    for row in engine.tables.handlers:
        assert row["steps"] > 50 * SHARE


@pytest.mark.evidence("Healthy parts: invalid value")
def test_one_invalid_value_is_as_a_frame_that_was_not_there(case):
    rng = np.random.default_rng(SEED)
    _, _, usual = run(case, case.frames)
    for k, (message, signal) in enumerate(places_of(case, rng)):
        count = len(case.places[message, signal][0])
        value = VALUES[(k + int(rng.integers(len(VALUES)))) % len(VALUES)]
        first = int(rng.integers(count // 4, max(3 * count // 4, 1)))
        frames, spoilt = spoiled(case, message, signal, value, first, first + 1)
        engine, failed, bad = run(case, frames)
        told = f"{message}.{signal} = {value} in frame {first} of it (seed {SEED})"
        assert engine.counters()["invalid_values"] == spoilt, told
        assert not failed, told
        assert bad <= usual, told
        assert not any(np.isnan(engine.tables.mailbox[:-1])), told


@pytest.mark.evidence("AUTOSAR DEM: invalid signals")
def test_invalid_values_for_ever_are_not_tested_and_accuse_nobody(case):
    rng = np.random.default_rng(SEED)
    _, _, usual = run(case, case.frames)
    for k, (message, signal) in enumerate(places_of(case, rng)):
        count = len(case.places[message, signal][0])
        value = VALUES[(k + int(rng.integers(len(VALUES)))) % len(VALUES)]
        frames, spoilt = spoiled(case, message, signal, value, count // 2, count)
        engine, failed, bad = run(case, frames)
        told = f"{message}.{signal} = {value} from the middle on (seed {SEED})"
        assert engine.counters()["invalid_values"] == spoilt, told
        names = {engine.faults[k].id for k in failed}
        takes_nan = [row["takes_nan"] == 1 for row in engine.tables.handlers]
        # Who goes on without an input says that it is missing, and keeps NaN for it until it is back.
        assert all(name.endswith("_missing") for name in names), told
        assert {(k, path) for k, path in bad if not takes_nan[k]} <= usual, told
