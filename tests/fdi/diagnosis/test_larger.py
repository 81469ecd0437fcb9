"""A part that sees a failed test hardly explains it, but badly: the likelier of it with another part is looked at."""

from random_systems import ran

from gateway_fdi.diagnosis.state import FAILED, PASSED
from gateway_fdi.diagnosis.system import Component, Link, Test

STANDS = ("FL", "FR", "RL", "RR")
PARTS = [
    Component("frozen wheels", prior=1e-4),
    Component("speed", prior=3e-4),
    *(Component(name, prior=1e-3) for name in STANDS),
]


def test_a_checksum_beside_a_message_that_stands_is_not_a_false_alarm():
    """The speed's message says when wheels must move, so that it could explain all, if hardly."""
    stands = [Test(n, (Link("frozen wheels", 0.9), Link(n, 0.15), Link("speed", 0.01)), 1e-6, 1.0) for n in STANDS]
    crc = Test("crc", (Link("speed", 0.3),), 1e-6, 1.0)
    said = [("crc", FAILED, 1_000_000_000, 0.0), *((name, FAILED, 2_000_000_000, 0.0) for name in STANDS)]
    (group,) = ran(PARTS, [*stands, crc], said).diagnose()
    first, second, *_ = group.diagnoses
    assert [PARTS[k].name for k in first.components] == ["frozen wheels", "speed"]
    assert first.probability > 0.98
    assert second.probability < 0.02


def relations():
    """Return what is said where the speed is off by 15, and a wheel, too, so that their relation holds."""
    parts = [Component("speed", prior=1e-3), *(Component(m, prior=3e-4) for m in ("message", "wheels")), *PARTS[2:]]
    seen = Link("speed", 0.3, 1.0), Link("message", 0.006, via="speed")
    tests = [Test(n, (*seen, Link(n, 0.3, -1.0), Link("wheels", 0.006, via=n)), 1e-6, 1.0, noise=0.5) for n in STANDS]
    fails = [(n, FAILED, 1_000_000_000, 15.0) for n in STANDS[1:]]
    passes = [("FL", PASSED, k * 1_000_000_000, 0.0) for k in (1, 4)]
    (group,) = ran(parts, tests, [*fails, *passes]).diagnose()
    return {tuple(parts[k].name for k in one.components): one.probability for one in group.diagnoses}


def test_a_message_has_the_size_of_the_signal_that_it_is_seen_by():
    told = relations()
    assert told["speed", "FL"] > 0.9
    assert told.get(("message",), 0.0) < 0.01, "it would be off for the first wheel, too"


def test_a_part_that_could_cure_a_misfit_pays_for_it():
    """The wheels' message could make the wheel's relation hold again: it makes values wrong as seldom as it does."""
    told = relations()
    assert told.get(("speed", "wheels"), 0.0) < 0.1 * told["speed", "FL"]
