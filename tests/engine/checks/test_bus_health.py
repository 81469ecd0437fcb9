"""The health of a bus: error frames and the condition of the interface become verdicts."""

import pytest
from amount import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.bus import conditions as c
from gateway.bus.frames import ERROR
from gateway.engine.checks import bus_health
from gateway.engine.checks.bus_health import BusInstance
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.engine.gate import Gate

FAILED, PASSED = QUALIFIED_FAILED, QUALIFIED_PASSED


def error(t_ms, classes, *, controller=0, protocol=0, location=0, tec=0, rec=0):
    return (t_ms, ERROR | classes, bytes([0, controller, protocol, location, 0, 0, tec, rec]))


def condition(t_ms, kind, lost=0, bus=0):
    return (t_ms, ERROR, bytes([kind, 0, 0, 0]) + lost.to_bytes(4, "little"), bus)


@pytest.fixture
def rig(build, tools):
    """An engine with two buses; ``rig.feed`` returns (ms, fault, verdict) of what it qualifies."""

    class Rig:
        def __init__(self, *monitors, params=None, **options):
            params = bus_health.Params(**(params or {}))
            self.engine = build(*monitors, buses=[BusInstance("a", params), BusInstance("b")], **options)
            self.names = [slot.id for slot in self.engine.faults]
            self.evidence = {}

        def feed(self, *rows, until=None):
            seen = tools.Collector()
            if rows:
                frames = tools.batch(*(row[:3] for row in rows))
                frames["bus"] = [row[3] if len(row) > 3 else 0 for row in rows]
                self.engine.process(frames, seen)
            if until is not None:
                self.engine.advance(round(until * 1e6), seen)
            out = []
            for t_ns, fault, kind, _, _, value, limit, evidence in seen.events:
                if kind in (FAILED, PASSED):
                    out.append((t_ns / 1e6, self.names[fault], kind))
                    self.evidence[self.names[fault], kind] = (value, limit, *evidence[:3])
            return out

    return Rig


def test_bus_off_is_set_and_heals_when_the_controller_restarts_or_a_frame_comes(rig, tools):
    bus = rig()
    assert bus.feed(error(1, c.BUS_OFF, tec=248, rec=3)) == [(1, "a.bus_off", FAILED)]
    assert bus.evidence["a.bus_off", FAILED] == (248, 255, 248, 3, 0)
    assert bus.feed(error(2, c.RESTARTED)) == [
        (2, "a.bus_off", PASSED),
        (2, "a.bus_passive", PASSED),
    ]
    assert bus.feed(error(3, c.BUS_OFF | c.CONTROLLER, controller=c.TX_PASSIVE)) == [
        (3, "a.bus_off", FAILED),
        (3, "a.bus_passive", FAILED),
    ]
    assert bus.feed(tools.alpha(4, 0)) == [(4, "a.bus_off", PASSED)], "it was received"
    assert bus.feed(error(5, c.CONTROLLER, controller=c.ACTIVE)) == [(5, "a.bus_passive", PASSED)]
    # Active again proves the same without a restart; off at once with it is off.
    assert bus.feed(error(6, c.BUS_OFF)) == [(6, "a.bus_off", FAILED)]
    assert bus.feed(error(7, c.CONTROLLER, controller=c.ACTIVE)) == [(7, "a.bus_off", PASSED)]
    assert bus.feed(error(8, c.BUS_OFF | c.RESTARTED)) == [(8, "a.bus_off", FAILED)]
    counts = bus.engine.error_counters(0)
    assert {name: n for name, n in counts.items() if n} == {
        "bus_off": 4, "restarted": 2, "controller": 3
    }  # fmt: skip
    assert not any(bus.engine.error_counters(1).values())


def test_error_passive_heals_at_warning_too_and_warning_is_no_fault(rig):
    bus = rig()
    assert bus.feed(error(1, c.CONTROLLER, controller=c.RX_WARNING)) == [(1, "a.bus_passive", PASSED)]
    assert bus.feed(error(2, c.CONTROLLER, controller=c.RX_PASSIVE, tec=5, rec=130)) == [(2, "a.bus_passive", FAILED)]
    assert bus.evidence["a.bus_passive", FAILED] == (130, 127, 5, 130, 0)
    assert bus.feed(error(3, c.CONTROLLER, controller=c.TX_WARNING)) == [(3, "a.bus_passive", PASSED)]


def test_protocol_errors_are_a_fault_from_the_tenth_in_a_second_and_heal_by_silence(rig):
    bus = rig()
    slow = [error(200 * k, c.PROTOCOL | c.BUS_ERROR) for k in range(20)]
    assert not bus.feed(*slow), "five a second"
    fast = [error(10_000 + 10 * k, c.PROTOCOL, protocol=4, location=0x1D) for k in range(12)]
    assert bus.feed(*fast) == [(10_090, "a.bus_errors", FAILED)]
    assert bus.evidence["a.bus_errors", FAILED] == (10, 10, c.PROTOCOL, 4, 0x1D)
    assert not bus.feed(until=11_109)
    assert bus.feed(until=11_111) == [(11_110, "a.bus_errors", PASSED)], "a second after the last"
    assert not bus.feed(*[error(12_000 + k, c.LOST_ARBITRATION) for k in range(50)]), "usual"
    assert bus.engine.error_counters(0)["lost_arbitration"] == 50


def test_a_controllers_own_overflow_is_one_too(rig):
    bus = rig()
    overflow = error(1, c.CONTROLLER, controller=c.RX_OVERFLOW)
    assert bus.feed(overflow, until=1000) == [(1, "a.bus_overflow", FAILED)]
    assert bus.feed(until=1002) == [(1001, "a.bus_overflow", PASSED)]


def test_an_interface_that_starts_anew_has_no_past(rig):
    bus = rig()
    bus.feed(*[error(k, c.PROTOCOL) for k in range(9)])
    bus.feed(condition(10, c.RUNNING))
    assert not bus.feed(error(11, c.PROTOCOL)), "the first, not the tenth"
    bus.feed(condition(20, c.LOSS, 1), condition(21, c.RUNNING))
    assert not bus.feed(until=5000), "healed at once, not once more later"


def test_an_interface_that_is_lost_and_back(rig, tools):
    bus = rig()
    running = bus.feed(condition(0, c.RUNNING))
    assert [name for _, name, verdict in running if verdict == PASSED] == [
        f"a.{fault.name}" for fault in bus_health.FAULTS[: bus_health.SILENT]
    ], "all is well, and tested"
    assert bus.feed(condition(5, c.LOST)) == [(5, "a.bus_lost", FAILED)]
    assert bus.feed(condition(9, c.RUNNING)) == [(9, "a.bus_lost", PASSED)]
    assert bus.feed(condition(10, c.LOST), tools.alpha(11, 0))[-1] == (11, "a.bus_lost", PASSED)


@pytest.mark.evidence("Healthy parts: our losses")
def test_frames_lost_in_a_queue_are_a_fault_of_ours_not_of_the_sender(rig, tools):
    check = {"message": "Alpha", "timeout_ms": 100.0, "counter": {"signal": "Count"}}
    bus = rig(checks=[check])
    good = [tools.alpha(k, 0, count=k) for k in range(5)]
    bus.feed(*good)
    found = bus.feed(condition(5, c.LOSS, 7), tools.alpha(6, 0, count=12))
    assert found == [(5, "a.bus_overflow", FAILED)]
    assert bus.evidence["a.bus_overflow", FAILED] == (7, 0, 7, 0, 0)
    counter = bus.names.index("comm.Alpha.counter")
    assert bus.engine.fault_detection_counter(counter) < 0, "not one failed result"
    # Lost on the other bus, the jump is the sender's; after an interface was away nobody can tell.
    bus.feed(condition(7, c.LOSS, 7, bus=1), tools.alpha(8, 0, count=3))
    assert bus.engine.fault_detection_counter(counter) > 0
    bus.feed(tools.alpha(9, 0, count=4), tools.alpha(9.5, 0, count=5))
    before = bus.engine.fault_detection_counter(counter)
    bus.feed(condition(10, c.LOST), condition(11, c.RUNNING), tools.alpha(12, 0, count=12))
    assert bus.engine.fault_detection_counter(counter) < before
    assert not bus.feed(*[tools.alpha(20 + k, 0, count=13 + k & 15) for k in range(3)])
    steady = [tools.alpha(t, 0, count=t // 50 & 15) for t in range(50, 1050, 50)]
    healed = bus.feed(condition(30, c.LOSS, 2), *steady, until=1031)
    assert [h for h in healed if h[1] == "a.bus_overflow"] == [
        (30, "a.bus_overflow", FAILED),
        (1030, "a.bus_overflow", PASSED),
    ]
    assert bus.engine.error_counters(0)["lost"] == 9
    # Without the word of the queue the same jump is a failure of the alive counter.
    other = rig(checks=[check])
    jumps = [tools.alpha(k, 0, count=3 * k & 15) for k in range(9)]
    assert (3, "comm.Alpha.counter", FAILED) in other.feed(*jumps)


def test_silence_of_a_lost_bus_is_no_fault_of_each_message_on_it(rig, tools):
    check = {"message": "Alpha", "timeout_ms": 100.0}
    gate = {"comm.Alpha.timeout": Gate(roots=("a.bus_off", "a.bus_lost"))}
    bus = rig(checks=[check], gates=gate)
    bus.feed(condition(0, c.RUNNING), tools.alpha(1, 0))
    found = bus.feed(condition(50, c.LOST), until=5000)
    assert found == [(50, "a.bus_lost", FAILED)]
    # Back again: a whole timeout from now, not from the last frame.
    assert bus.feed(condition(5001, c.RUNNING), until=5100) == [(5001, "a.bus_lost", PASSED)]
    assert bus.feed(until=5102) == [(5101, "comm.Alpha.timeout", FAILED)]
    assert bus.evidence["comm.Alpha.timeout", FAILED][0] == 100, "silent for so long, not since ever"


def test_a_bus_that_is_not_watched_is_counted_only(rig):
    bus = rig(params={"watched": False})
    assert not bus.feed(error(1, c.BUS_OFF), condition(2, c.LOST), condition(3, c.LOSS, 4))
    assert bus.engine.error_counters(0)["bus_off"] == 1
    assert bus.engine.error_counters(0)["lost"] == 4
    assert not any(name.startswith("a.") for name in bus.names)


def test_each_bus_has_dtcs_of_its_own():
    assert [fault.dtc for fault in bus_health.faults_of("U0001")] == [
        "U0001-88", "U0001-08", "U0001-81", "U0001-31", "U0001-04", "U0001-87",
        "U0001-55"
    ]  # fmt: skip
    usual = bus_health.Params()
    assert bus_health.codes_of([usual] * len(bus_health.CODES)) == list(bus_health.CODES)
    assert len(set(bus_health.CODES)) == 8
    asked = bus_health.Params(code="U0001")
    assert bus_health.codes_of([usual, asked, usual]) == ["U0028", "U0001", "U0037"]


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(st.integers(0, 700), st.integers(0, 0x3FF), st.binary(min_size=8, max_size=8)),
        min_size=1,
        max_size=40,
    ),
    st.integers(1, 7),
)
def test_any_error_frame_in_any_batch_gives_the_same(build, tools, rows, cut):
    """Error frames of any class and content: batch boundaries change nothing, and a fault heals only after it
    failed.
    """
    frames, now = [], 0.0
    for gap, classes, data in rows:
        now += gap
        frames.append((now, ERROR | classes, data))
    results = []
    for size in (len(frames), cut):
        engine = build(buses=[BusInstance("a")])
        seen = tools.Collector()
        for k in range(0, len(frames), size):
            engine.process(tools.batch(*frames[k : k + size]), seen)
        engine.advance(round((now + 2000) * 1e6), seen)
        results.append((seen.events, engine.error_counters(0)))
    assert results[0] == results[1]
    verdicts = {}
    for _, fault, kind, *_ in results[0][0]:
        if fault < 0:  # the clock was set: that is no verdict
            continue
        assert verdicts.get(fault) != kind, "a verdict is told once"
        verdicts[fault] = kind
    errors = [slot.id for slot in engine.faults].index("a.bus_errors")
    assert verdicts.get(errors) != FAILED, "two silent seconds heal it"


HEARS_AGAIN = {
    "the controller restarted": lambda tools: [error(310, c.RESTARTED)],
    "it is active": lambda tools: [error(310, c.CONTROLLER, controller=c.ACTIVE)],
    "another message came": lambda tools: [tools.beta(310, 0)],
}


@pytest.mark.evidence("Healthy parts: bus-off")
@pytest.mark.parametrize("how", HEARS_AGAIN)
def test_what_was_sent_while_the_gateway_was_bus_off_is_missed_by_nobody(how, rig, tools):
    """A healthy sender counts on; its next frame comes when it is due, not at once."""
    check = {"message": "Alpha", "timeout_ms": 100.0, "counter": {"signal": "Count"}}
    gates = {"comm.Alpha.timeout": Gate(roots=("a.bus_off", "a.bus_lost"))}
    bus = rig(checks=[check], gates=gates)
    bus.feed(*[tools.alpha(50 * k, 0, count=k) for k in range(5)])
    assert bus.feed(error(205, c.BUS_OFF)) == [(205, "a.bus_off", FAILED)]
    again = HEARS_AGAIN[how](tools)
    # The last deadline that was put off lies at 300 ms and the next at 400 ms: the first frame after that is healthy.
    found = bus.feed(*again, tools.alpha(405, 0, count=8))
    assert [name for _, name, verdict in found if verdict == FAILED] == []
    for kind in ("counter", "timeout"):
        assert bus.engine.fault_detection_counter(bus.names.index(f"comm.Alpha.{kind}")) < 0, "not one failed result"
    # Who is still silent is told, a whole timeout later.
    silent = rig(checks=[check], gates=gates)
    silent.feed(tools.alpha(150, 0), error(205, c.BUS_OFF))
    found = silent.feed(*again, until=1000)
    assert [row for row in found if row[2] == FAILED] == [(410, "comm.Alpha.timeout", FAILED)]


LOST = {
    "in our queue": lambda t: condition(t, c.LOSS, 40),
    "in the controller": lambda t: error(t, c.CONTROLLER, controller=c.RX_OVERFLOW),
}


@pytest.mark.evidence("Healthy parts: our losses")
@pytest.mark.parametrize("where", LOST)
def test_frames_that_were_lost_here_are_missed_by_nobody(where, rig, tools):
    """The loss is told with the first frame after it: the deadlines before that lie in what was not heard."""
    check = {"message": "Alpha", "timeout_ms": 30.0, "counter": {"signal": "Count"}}
    told = []
    for cut in (1, 2, 9):
        bus = rig(checks=[check])
        rows = [tools.alpha(10 * k, 0, count=k) for k in range(6)]
        rows += [LOST[where](131), *[tools.alpha(max(t, 131), 0, count=t // 10 & 15) for t in (130, 140, 150, 160)]]
        found = []
        for k in range(0, len(rows), cut):
            found += bus.feed(*rows[k : k + cut])
        assert [name for _, name, verdict in found if verdict == FAILED] == ["a.bus_overflow"]
        told.append(found)
        counter = bus.names.index("comm.Alpha.counter")
        assert bus.engine.fault_detection_counter(counter) < 0, "not one failed result"
        # Who is silent after it is told.
        assert bus.feed(until=1000)[0] == (190, "comm.Alpha.timeout", FAILED)
    assert told[0] == told[1] == told[2]


def test_losses_without_end_do_not_hide_a_dead_sender(rig, tools):
    check = {"message": "Alpha", "timeout_ms": 100.0}
    bus = rig(checks=[check])
    found = bus.feed(tools.alpha(0, 0), *[condition(50 * k, c.LOSS, 1) for k in range(1, 41)])
    assert [row for row in found if row[1] == "comm.Alpha.timeout" and row[2] == FAILED] == [
        (600, "comm.Alpha.timeout", FAILED)  # ten times its time began anew, the last time at 500 ms
    ]
    # Each frame of it is a beginning.
    bus = rig(checks=[check])
    rows = [tools.alpha(t, 0) if t % 500 == 0 else condition(t, c.LOSS, 1) for t in range(0, 5000, 50)]
    assert not [row for row in bus.feed(*rows) if row[1] == "comm.Alpha.timeout" and row[2] == FAILED]
