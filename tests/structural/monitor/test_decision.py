"""What tests say together, where they and the faults need masks of several words: as sets say it."""

import numpy as np
import pytest

from gateway.monitors import contract
from gateway_fdi.isolation import machine, table
from gateway_fdi.jit import COMPILED
from gateway_fdi.masks import pack, unpack
from gateway_plants.structural.monitor import decision, records
from gateway_plants.structural.monitor.plan import MOST_FAULTS, MOST_TESTS

TESTS, FAULTS = 150, 140
#: Of the masks.
SIZE = max(MOST_TESTS, MOST_FAULTS)
PERIOD_NS = 100_000_000


def monitor(seed):
    """A state and constants with random signatures, each fault its own; the signatures as sets of tests."""
    rng = np.random.default_rng(seed)
    signatures = [frozenset(map(int, rng.choice(TESTS, size=rng.integers(2, 6), replace=False))) for _ in range(FAULTS)]
    signatures[7] = frozenset([0, 70, 149])
    signatures[139] = frozenset([0, 70, 148])
    s, c = np.zeros(1, records.State.dtype).view(np.recarray)[0], np.zeros(1, records.Const.dtype).view(np.recarray)[0]
    table.prepare(c, signatures, [[k] for k in range(FAULTS)], tests=TESTS, size=SIZE)
    confirmed_after(s, c, 0)
    c.shown[:] = records.NOT_USED
    c.shown[:, 0], c.shown[:, 1], c.shown[:, 2] = records.LISTED, records.RANKED, records.KINDS * 149 + records.NORM
    decision.prepare_window(c)
    for k in range(TESTS):
        decision.prepare(c, k, 1.0, 1.0, 5.0)
    return s, c, signatures


def confirmed_after(s, c, time_ns):
    machine.prepare(s, c, confirm_ns=time_ns, hold_ns=time_ns, pending_ns=decision.PENDING * time_ns)


def step(s, c, fired, seconds):
    """Step it by samples with some residuals large; the results of all of them: fault -> verdict, and evidence."""
    dtype = contract.results_of(contract.Evidence.dtype, None)
    results, evidence = {}, {}
    for _ in range(round(seconds * 1e9 / PERIOD_NS)):
        s.at_ns += PERIOD_NS
        s.dt = PERIOD_NS * 1e-9
        s.residual[:] = 0.0
        s.residual[list(fired)] = 10.0
        out = np.zeros(1, dtype).view(np.recarray)[0]
        decision.decide(s, c, out)
        assert out.overflow == 0
        for one in out.results[: out.n]:
            results[int(one.fault)] = int(one.result)
            if one.result == contract.FAILED:
                evidence[int(one.fault)] = one.evidence.value.copy()
    return results, evidence


@pytest.mark.costly
@pytest.mark.parametrize("seed", range(3))
def test_many_faults(seed):
    s, c, signatures = monitor(seed)
    results, _ = step(s, c, (), 4.0)
    assert results == dict.fromkeys(range(FAULTS + 1), contract.PASSED)  # all of them, some at a time
    for fault in (7, 139, 3, 100):
        results, evidence = step(s, c, signatures[fault], 4.0)
        alone = [k for k, each in enumerate(signatures) if signatures[fault] <= each] == [fault]
        expected = fault if alone else FAULTS
        assert [k for k, verdict in results.items() if verdict == contract.FAILED] == [expected]
        listed, ranked, norm = evidence[expected][:3]
        numbers = sorted(signatures[fault])[:5]
        assert listed == sum((n + 1) * 1000 ** (len(numbers) - 1 - k) for k, n in enumerate(numbers))
        assert unpack(s.fired[None, :], TESTS)[0].nonzero()[0].tolist() == sorted(signatures[fault])
        assert (norm > 1) == (149 in signatures[fault])
        if alone:
            assert ranked == fault + 1
        step(s, c, (), 60.0 if COMPILED else 10.0)
        assert s.found == -1


def test_two_faults_at_once_are_not_isolated():
    s, c, signatures = monitor(1)
    results, _ = step(s, c, signatures[7] | signatures[139] | signatures[3], 4.0)
    assert [k for k, verdict in results.items() if verdict == contract.FAILED] == [FAULTS]


def test_where_something_may_be_off_tests_name_nobody_against_sizes():
    """All tests of a fault, and of it alone, have fired: sizes say nothing, the same fault, another one."""
    for likely, expected in (((), FAULTS), ((7,), 7), ((7, 139), FAULTS), ((139,), FAULTS)):
        s, c, signatures = monitor(0)
        s.by_size = 1
        s.likely = pack([likely], SIZE)[0]
        results, _ = step(s, c, signatures[7], 4.0)
        assert [k for k, verdict in results.items() if verdict == contract.FAILED] == [expected], likely


def up_and_down(s, c, fired, chatters, seconds):
    """As :func:`step`, with one test that is just above and just below its threshold by turns of one sample."""
    dtype = contract.results_of(contract.Evidence.dtype, None)
    told = []
    for n in range(round(seconds * 1e9 / PERIOD_NS)):
        s.at_ns += PERIOD_NS
        s.dt = PERIOD_NS * 1e-9
        s.residual[:] = 0.0
        s.residual[list(fired)] = 10.0
        s.residual[chatters] = 2.4 if n == 0 else 0.0 if n % 2 else 2.0  # T: 1.4, 0.4, 1.4, ... against J = 1
        out = np.zeros(1, dtype).view(np.recarray)[0]
        decision.decide(s, c, out)
        told += [int(one.fault) for one in out.results[: out.n] if one.result == contract.FAILED]
    return told


@pytest.mark.costly
def test_one_that_is_up_and_down_does_not_keep_all_from_being_told():
    s, c, signatures = monitor(0)
    confirmed_after(s, c, 10 * PERIOD_NS)
    assert [k for k, each in enumerate(signatures) if signatures[7] <= each] == [7]
    assert up_and_down(s, c, (0, 70), 149, 0.9) == []
    assert set(up_and_down(s, c, (0, 70), 149, 6.0)) == {7}
    step(s, c, (), 30.0)
    assert s.found == -1


def test_a_test_that_was_up_for_a_moment_accuses_nobody():
    s, c, _ = monitor(0)
    confirmed_after(s, c, 10 * PERIOD_NS)
    s.residual[:] = 0.0
    for _ in range(3):
        assert up_and_down(s, c, (), 149, 0.1) == []  # up once
        results, _ = step(s, c, (), 2.0)
        assert contract.FAILED not in results.values()


@pytest.mark.costly
def test_a_size_that_nothing_says_is_no_number():
    """The current of a winding is 0: its resistance may be anything."""
    s, c, signatures = monitor(0)
    c.meters, c.memory_s, c.forgets[0] = 1, 1.0, 1e30
    s.gain[0], s.measured[0] = 0.0, 0.0
    step(s, c, signatures[7], 1.0)
    assert np.isnan(s.sizes[0])
    s.gain[0], s.measured[0] = 2.0, -1.0
    step(s, c, signatures[7], 1.0)
    assert s.sizes[0] == pytest.approx(0.5)
    step(s, c, (), 60.0 if COMPILED else 10.0)
    assert s.sizes[0] == 0.0


def test_a_size_waits_until_the_generators_have_settled():
    s, c, signatures = monitor(0)
    c.meters, c.memory_s, c.forgets[0], c.settle_ns = 1, 1e6, 1e30, 10 * PERIOD_NS
    s.since_ns = -(10**12)
    s.gain[0], s.measured[0] = 1.0, -3.0
    step(s, c, signatures[7], 2.0)
    assert s.sizes[0] == pytest.approx(3.0)
    s.since_ns = int(s.at_ns)  # all began anew
    s.measured[0] = -500.0
    step(s, c, signatures[7], 0.9)
    assert s.sizes[0] == pytest.approx(3.0)
