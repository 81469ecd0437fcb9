"""Bus faults in a whole gateway: what is watched by default, and what a user may change."""

import numpy as np
import pytest
from bench_config import beat, write_config

from gateway.bus import conditions as c
from gateway.bus.conditions import condition_frame
from gateway.bus.frames import ERROR, empty, put
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.errors import InputErrors

MS = 1_000_000


def gateway_of(folder, change=lambda text: text, **options):
    path = write_config(folder, **options)
    path.write_text(change(path.read_text()))
    return Gateway(load_config(path), file=path)


def frame(t_ms, can_id, data):
    out = empty(1)
    put(out, 0, t_ms * MS, can_id, data)
    return out


def dtcs(gateway, *, active=True):
    return [str(e.dtc) for e in gateway.memory.entries() if bool(e.status & 1) == active]


def silence_of_a_lost_bus(gateway):
    gateway.start(0)
    gateway.feed(condition_frame(0, 0, c.RUNNING))
    gateway.feed(frame(1, 0x300, beat(0)))
    gateway.feed(condition_frame(50 * MS, 0, c.LOST))
    gateway.advance(5000 * MS)
    return dtcs(gateway)


@pytest.mark.evidence("Nothing is silent: lost bus")
def test_a_lost_bus_is_one_dtc_by_default(tmp_path):
    gateway = gateway_of(tmp_path)
    assert silence_of_a_lost_bus(gateway) == ["U0001-31"]
    known = {d.id: d.caused_by for d in gateway.catalogue}
    assert known["chassis.Beat.timeout"] == ("chassis.bus_off", "chassis.bus_lost")
    assert known["chassis.Beat.counter"] == ()


def test_without_the_watch_the_messages_are_missed(tmp_path):
    def unwatched(text):
        return text.replace("[[bus.check]]", "health = { watched = false }\n[[bus.check]]")

    gateway = gateway_of(tmp_path, unwatched)
    assert silence_of_a_lost_bus(gateway) == ["U0100-87"]
    assert not any("bus_" in d.id for d in gateway.catalogue)


def test_a_cause_of_ones_own_takes_the_place_of_the_bus(tmp_path):
    def own(text):
        return text + '\n[fault."chassis.Beat.timeout"]\ncaused_by = ["chassis.Beat.length"]\n'

    gateway = gateway_of(tmp_path, own)
    assert silence_of_a_lost_bus(gateway) == ["U0001-31", "U0100-87"]


def test_settings_of_a_bus_fault_are_those_of_any_fault(tmp_path):
    def own(text):
        return text + '\n[fault."chassis.bus_off"]\ndtc = "U0073-88"\npriority = 1\nindicator = true\n'

    gateway = gateway_of(tmp_path, own)
    gateway.start(0)
    gateway.feed(frame(1, ERROR | c.BUS_OFF, bytes(8)))
    (entry,) = gateway.memory.entries()
    assert str(entry.dtc) == "U0073-88"
    assert entry.status & 0x80, "the warning indicator is asked for"


def test_a_wrong_setting_is_named(tmp_path):
    path = write_config(tmp_path)
    text = path.read_text()
    path.write_text(text.replace("[[bus.check]]", 'health = { code = "X0001", errors = 0 }\n[[bus.check]]'))
    with pytest.raises(InputErrors) as error:
        load_config(path)
    assert "bus[0].health.code" in str(error.value)
    assert "bus[0].health.errors" in str(error.value)


@pytest.mark.evidence("Live is replay: bus faults")
def test_a_recording_with_its_conditions_replays_to_the_same_faults(tmp_path):
    """What happened to the bus is in the log, as candump writes error frames."""
    from gateway.bus.logs import LogReader, open_writer

    frames = np.concatenate(
        [
            condition_frame(0, 0, c.RUNNING),
            frame(1, 0x300, beat(0)),
            frame(2, ERROR | c.BUS_OFF, bytes(8)),
            frame(3, ERROR | c.RESTARTED, bytes(8)),
            condition_frame(4 * MS, 0, c.LOSS, 12),
            condition_frame(9 * MS, 0, c.LOST),
            condition_frame(20 * MS, 0, c.RUNNING),
        ]
    )
    told = []
    for k in range(2):
        if k:
            with open_writer(tmp_path / "drive.log") as log:
                log.write(frames)
            (frames,) = LogReader(tmp_path / "drive.log")
        gateway, events = gateway_of(tmp_path), []
        gateway.listen(events.append)
        gateway.start(0)
        gateway.feed(frames)
        told.append(events)
        assert gateway.summary(1.0)["buses"]["chassis"] == {
            "bus_off": 1, "restarted": 1, "lost": 12
        }  # fmt: skip
    assert told[0] == told[1]
    assert [e["dtc"] for e in told[0] if e["event"] == "dtc" and e["status"] & 1] == [
        "U0001-88", "U0001-04", "U0001-31"
    ]  # fmt: skip


def test_the_clock_is_followed_while_a_tester_has_switched_reception_off(tmp_path):
    gateway = gateway_of(tmp_path)
    gateway.start(0)
    gateway.controls.set_communication(receive=False, send=True)
    gateway.feed(np.concatenate([frame(1, 0x300, beat(0)), c.step_frame(2 * MS, 3_600_000_000)]))
    assert gateway.engine.offset_ns == 3600 * 10**9
    assert gateway.engine.counters()["decoded"] == 0
    gateway.stop(5 * MS)
    assert gateway.store.cycles()["power"].t_ns == 3600 * 10**9 + 5 * MS


def test_the_fault_of_the_clock_is_set_up_like_any_other(tmp_path):
    def own(text):
        return text + '\n[fault."gateway.clock_stepped"]\ndtc = "U3000-64"\nindicator = true\n'

    gateway = gateway_of(tmp_path, own)
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    gateway.feed(c.step_frame(2 * MS, -500_000))
    (entry,) = gateway.memory.entries()
    assert (str(entry.dtc), bool(entry.status & 0x80)) == ("U3000-64", True)
    assert entry.record.first_ns == 2 * MS - 500 * MS
    assert [e["event"] for e in events] == ["clock", "dtc"]
    gateway.advance(9_999 * MS)
    assert "U3000-64" in dtcs(gateway)
    gateway.advance(10_003 * MS)
    assert "U3000-64" not in dtcs(gateway), "healed after 10 s without another step"


def test_a_clock_that_is_not_watched_is_told_and_no_fault(tmp_path):
    gateway = gateway_of(tmp_path, more="[clock]\nwatched = false\n")
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    gateway.feed(c.step_frame(2 * MS, 1_000_000))
    assert events == [{"event": "clock", "t_ns": 1002 * MS, "step_s": 1.0}]
    assert gateway.memory.entries() == []
    assert gateway.catalogue.get("gateway.clock_stepped") is None


def test_a_reload_goes_on_with_the_clock_and_its_fault(tmp_path):
    gateway = gateway_of(tmp_path)
    gateway.start(0)
    gateway.feed(c.step_frame(2 * MS, 7_000_000))
    gateway.finish(3 * MS)
    successor = Gateway(gateway.config, store=gateway.store)
    successor.succeed(gateway)
    assert successor.engine.offset_ns == 7 * 10**9
    assert dtcs(successor) == ["U3000-62"]
    successor.feed(frame(11_000, 0x300, beat(0)))
    assert "U3000-62" in dtcs(successor, active=False), "healed by its time from before the reload"


def test_a_clock_that_is_not_set_is_a_passed_test_of_each_operation_cycle(tmp_path):
    """Or readiness would never be complete."""
    gateway = gateway_of(tmp_path)
    not_completed = 0x50
    gateway.start(0)
    gateway.advance(0)
    assert gateway.memory.status("gateway.clock_stepped") == not_completed
    gateway.advance(10_000 * MS)
    assert gateway.memory.status("gateway.clock_stepped") == 0
    gateway.controls.restart_cycle()
    assert gateway.memory.status("gateway.clock_stepped") == 0x40
    gateway.advance(20_000 * MS)
    assert gateway.memory.status("gateway.clock_stepped") == 0


@pytest.mark.parametrize("passes", [1, 3])
def test_a_long_gap_says_of_the_clock_what_its_windows_say_one_by_one(passes, tmp_path):
    """A silence that was let pass in ticks, and the same as a gap in a recording."""

    def own(text):
        return f'{text}\n[fault."gateway.clock_stepped"]\ndebounce = {{ passed_after = {passes} }}\n'

    told = []
    for tick_ms in (100, 10**7):
        gateway, events = gateway_of(tmp_path, own, timeout_ms=3.6e6), []
        gateway.listen(events.append)
        gateway.start(0)
        gateway.feed(c.step_frame(2 * MS, 1_000_000))
        for t_ms in range(tick_ms, 100_001, tick_ms):
            gateway.advance(t_ms * MS)
        gateway.advance(100_001 * MS)
        gateway.feed(c.step_frame(100_002 * MS, 1_000_000))
        gateway.advance(105_000 * MS)
        told.append(events)
    assert told[0] == told[1]
    healed = [e["t_ns"] for e in told[0] if e["event"] == "dtc" and not e["status"] & 1]
    assert healed == [1002 * MS + passes * 10_000 * MS]


@pytest.mark.evidence("Healthy parts: tester")
def test_what_was_sent_while_a_tester_had_reception_switched_off_is_missed_by_nobody(tmp_path):
    at_once = '\n[fault."chassis.Beat.counter"]\ndebounce = { failed_after = 1 }\n'
    gateway = gateway_of(tmp_path, lambda text: text + at_once)
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    for t_ms in range(0, 5000, 200):  # each 200 ms, missing after 300 ms
        if t_ms in (1000, 3000):
            gateway.controls.set_communication(receive=t_ms == 3000, send=True, by="tester")
            gateway.advance((t_ms + 100) * MS)
        gateway.feed(frame(t_ms + 190, 0x300, beat(t_ms // 200)))
    assert {event["fault"] for event in events if event["event"] == "dtc"} == {"gateway.monitoring_off"}
    gateway.advance(6000 * MS)
    assert dtcs(gateway) == ["U0100-87"], "it is supervised again"


@pytest.mark.parametrize("ends", [c.RESTARTED, None])
def test_after_bus_off_the_first_frames_accuse_nobody(ends, tmp_path):
    at_once = '\n[fault."chassis.Beat.counter"]\ndebounce = { failed_after = 1 }\n'
    gateway = gateway_of(tmp_path, lambda text: text + at_once)
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    for t_ms in range(0, 5000, 200):
        if t_ms == 1000:
            gateway.feed(frame(t_ms, ERROR | c.BUS_OFF, bytes(8)))
        if t_ms == 3000 and ends is not None:
            gateway.feed(frame(t_ms, ERROR | ends, bytes(8)))
        if not 1000 <= t_ms < 3000:
            gateway.feed(frame(t_ms + 190, 0x300, beat(t_ms // 200)))
    assert {event["dtc"] for event in events if event["event"] == "dtc"} == {"U0001-88"}
    gateway.advance(6000 * MS)
    assert dtcs(gateway) == ["U0100-87"], "it is supervised again"
