"""Test results of other processes: debounce, evidence, rights, bounds, and what happens when a reporter is gone."""

import json
import os
import random

import pytest
from reporting import write_config

from gateway.bus.frames import empty, put
from gateway.config.load import load_config
from gateway.faults.status import Status
from gateway.runtime.app import Gateway
from gateway_commands.validation import mistakes
from gateway_fdi.errors import InputErrors
from gateway_serve.external_reports import MOST_STRANGERS

MS = 1_000_000
LOST = "gateway.reporter_lost"
HOT, SLOW, BLIND = "battery.hot", "battery.slow", "camera.blind"
OWN = os.geteuid()


class Bench:
    """A gateway, and reporters that have no socket."""

    def __init__(self, folder, **config):
        self.folder = folder
        self.gateway = Gateway(load_config(write_config(folder, **config)), None)
        self.events = []
        self.gateway.listen(self.events.append)
        self.gateway.start(0)
        self.now_s = 100.0
        self.wait(1000)

    def wait(self, milliseconds):
        for _ in range(0, milliseconds, 10):
            self.now_s += 0.01
            self.gateway.advance(self.gateway.engine.now_ns + 10 * MS)
            self.gateway.reports.pass_time()
        self.gateway.advance(self.gateway.engine.now_ns)

    def enter(self, uid=OWN, groups=(), pid=42):
        return self.gateway.reports.enter(uid, groups, pid)

    def send(self, number, fault, result, **data):
        return self.packet(number, {"fault": fault, "result": result, "data": data})

    def packet(self, number, asked):
        packet = asked if isinstance(asked, bytes) else json.dumps(asked).encode()
        answer = self.gateway.reports.take(number, packet, self.now_s)
        self.gateway.advance(self.gateway.engine.now_ns)
        return "accepted" if answer["ok"] else answer["refused"]

    def leave(self, number):
        self.gateway.reports.leave(number)
        self.gateway.advance(self.gateway.engine.now_ns)

    def failing(self, fault):
        return bool(self.gateway.memory.status(fault) & Status.TEST_FAILED)

    def told(self, kind="reporter"):
        return [event for event in self.events if event["event"] == kind]

    def results(self, fault):
        """What was told of a fault, in order."""
        found = []
        for event in self.events:
            if event.get("fault") == fault:
                found.append(event["result"] if event["event"] == "monitor" else event["status"] & 1)
        return found


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.gateway.close()


# What a result does


@pytest.mark.evidence("AUTOSAR DEM: monitor-internal debounce")
def test_prefailed_and_prepassed_are_debounced_failed_and_passed_qualify_at_once(bench):
    one = bench.enter()

    def verdicts(*results):
        found = []
        for result in results:
            assert bench.send(one, HOT, result) == "accepted"
            found.append(bench.failing(HOT))
        return found

    assert verdicts("prefailed", "prefailed", "prefailed") == [False, False, True]
    assert verdicts("prepassed", "prepassed") == [True, False]
    assert verdicts("failed", "prepassed", "prefailed") == [True, True, True]
    assert verdicts("passed", "prefailed") == [False, False]
    assert bench.gateway.memory.entry(HOT).record.occurrence == 2


def test_debounce_by_time_goes_on_between_reports(bench):
    one = bench.enter()
    bench.send(one, SLOW, "prefailed")
    bench.wait(80)
    assert not bench.failing(SLOW)
    bench.wait(40)
    assert bench.failing(SLOW)
    bench.send(one, SLOW, "prepassed")
    bench.wait(100)
    assert bench.failing(SLOW)
    bench.send(one, SLOW, "passed")
    assert not bench.failing(SLOW)
    bench.send(one, SLOW, "prefailed")
    bench.send(one, SLOW, "not_tested")
    bench.wait(500)
    assert not bench.failing(SLOW), "time does not count while it is not tested"


def test_a_report_is_stamped_by_the_engine_and_its_data_are_the_evidence(bench):
    one = bench.enter()
    now_ns = bench.gateway.engine.now_ns
    assert bench.send(one, HOT, "failed", temperature=81.5) == "accepted"
    (event,) = [e for e in bench.told("dtc") if e["fault"] == HOT]
    assert (event["t_ns"], event["dtc"]) == (now_ns, "P0A7E-98")
    entry = bench.gateway.memory.entry(HOT)
    assert entry.record.evidence["temperature [degC]"] == 81.5
    assert entry.record.evidence["cell"] is None, "it was not told"
    assert entry.freeze_frames


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        (b"", "malformed"),
        (b"\xff\x00", "malformed"),
        (b"[" * 4000, "malformed"),
        (b'"text"', "malformed"),
        (b'{"fault": "battery.hot"}', "malformed"),
        (b'{"fault": "battery.hot", "result": "broken"}', "malformed"),
        (b'{"fault": "battery.hot", "result": ["failed"]}', "malformed"),
        (b'{"fault": 5, "result": "failed"}', "malformed"),
        (b'{"fault": "battery.hot", "result": "failed", "data": [1]}', "malformed"),
        (b'{"fault": "battery.hot", "result": "failed", "id": {}}', "malformed"),
        (b'{"fault": "battery.hot", "result": "failed", "force": true}', "malformed"),
        (b'{"fault": "battery.hot", "result": "failed"}' + b" " * 4096, "malformed"),
        (b'{"fault": "battery.cold", "result": "failed"}', "unknown_fault"),
        (b'{"fault": "gateway.reporter_lost", "result": "passed"}', "unknown_fault"),
        (b'{"fault": "battery.hot", "result": "failed", "data": {"x": 1}}', "data"),
        (b'{"fault": "battery.hot", "result": "failed", "data": {"cell": "1"}}', "data"),
        (b'{"fault": "battery.hot", "result": "failed", "data": {"cell": true}}', "data"),
        (b'{"fault": "battery.hot", "result": "failed", "data": {"cell": NaN}}', "data"),
        (b'{"fault": "battery.hot", "result": "failed", "data": {"cell": 1' + b"0" * 400 + b"}}", "data"),
    ],
)
def test_what_is_no_report_is_refused_counted_and_changes_nothing(bench, asked, reason):
    one = bench.enter()
    assert bench.packet(one, asked) == reason
    assert not bench.failing(HOT)
    assert bench.gateway.reports.counters() == {"reports_accepted": 0, "reports_refused": 1, "reporters_lost": 0}


def test_whatever_is_sent_is_answered_and_counted(bench):
    seed = random.randrange(10**6)
    print("seed", seed)
    draw = random.Random(seed)
    values = [None, True, -1, 10**300, 1.5, "", "failed", HOT, "\ud800", [], [1], {}, {"cell": 1}, {"cell": None}, [[]]]
    one = bench.enter()
    packets = []
    for _ in range(300):
        keys = draw.sample(["fault", "result", "data", "id", "goodbye", "x"], draw.randrange(6))
        packet = json.dumps({"fault": HOT, "result": "passed"} | {key: draw.choice(values) for key in keys}).encode()
        if draw.random() < 0.5:
            at = draw.randrange(len(packet))
            packet = packet[:at] + draw.randbytes(draw.randrange(4)) + packet[at + draw.randrange(4) :]
        packets.append(packet)
        bench.wait(10)
    told = [json.loads(json.dumps(bench.gateway.reports.take(one, packet, bench.now_s))) for packet in packets]
    counters = bench.gateway.reports.counters()
    goodbyes = sum(answer["ok"] for answer in told) - counters["reports_accepted"]
    assert counters["reports_accepted"] + counters["reports_refused"] + goodbyes == len(packets)
    assert goodbyes >= 0


def test_a_misspelt_fault_is_answered_with_the_nearest_and_the_number_of_the_report(bench):
    asked = b'{"fault": "batery.hot", "result": "failed", "id": 7}'
    answer = bench.gateway.reports.take(bench.enter(), asked, 1.0)
    assert answer["id"] == 7
    assert "did you mean battery.hot" in answer["why"]


def test_while_monitoring_is_off_no_report_counts_and_it_says_so(bench):
    one = bench.enter()
    bench.gateway.controls.set_dtcs(False, "tester")
    assert [bench.send(one, HOT, result) for result in ("failed", "prefailed")] == ["monitoring_off"] * 2
    assert not bench.failing(HOT)
    bench.gateway.controls.set_dtcs(True, "tester")
    assert bench.send(one, HOT, "failed") == "accepted"


def test_enable_conditions_hold_for_it_as_for_monitors(tmp_path):
    extra = f'[fault."{HOT}"]\nenable = [{{ signal = "One.Level", min = 5 }}]\nseverity = "immediately"\n'
    bench = Bench(tmp_path, extra=extra)
    one = bench.enter()
    assert bench.send(one, HOT, "failed") == "not_enabled"
    frames = empty(1)
    put(frames, 0, bench.gateway.engine.now_ns + MS, 0x100, (600).to_bytes(2, "little") + bytes(6))
    bench.gateway.feed(frames)
    assert bench.send(one, HOT, "failed") == "accepted"
    assert bench.gateway.catalogue.get(HOT).severity & 0x80
    bench.gateway.close()


# Who may report


def test_who_has_no_right_is_turned_away_and_named_once(tmp_path):
    bench = Bench(tmp_path, battery='users = [54321, "nobody-of-this-machine"]', camera="groups = [777]")
    assert bench.enter(uid=11111) is None
    driver, crew, root = bench.enter(54321), bench.enter(55555, groups=[5, 777]), bench.enter(0)
    assert bench.send(driver, HOT, "failed") == "accepted"
    assert bench.send(driver, BLIND, "failed") == "not_allowed"
    assert bench.send(crew, BLIND, "failed") == "accepted"
    assert bench.send(crew, HOT, "passed") == "not_allowed"
    assert bench.send(root, HOT, "passed") == "accepted"
    counts = {state["reporter"]: state["counts"] for state in bench.gateway.reports.states()}
    assert counts == {
        "battery": {"accepted": 2, "not_allowed": 1},
        "camera": {"accepted": 1, "not_allowed": 1},
        "": {"turned_away": 1},
    }
    for uid in range(20_000, 20_000 + 3 * MOST_STRANGERS):
        assert bench.enter(uid) is None
    bench.gateway.close()


def test_only_the_gateways_user_and_root_may_report_by_default(bench):
    assert bench.enter(OWN) is not None
    assert bench.enter(0) is not None
    assert bench.enter(OWN + 12345) is None


def test_more_than_the_bound_is_refused_counted_and_told_once(tmp_path):
    bench = Bench(tmp_path, battery="events_per_s = 10")
    one = bench.enter()
    told = [bench.send(one, HOT, "passed") for _ in range(30)]
    assert told == ["accepted"] * 10 + ["rate"] * 20
    assert bench.send(one, BLIND, "passed") == "accepted", "each reporter has a bound of its own"
    bench.wait(500)
    assert [bench.send(one, HOT, "passed") for _ in range(6)] == ["accepted"] * 5 + ["rate"]
    (refused,) = bench.told()
    assert (refused["reporter"], refused["state"]) == ("battery", "refused")
    bench.wait(2000)
    assert [bench.send(one, HOT, "passed") for _ in range(11)] == ["accepted"] * 10 + ["rate"]
    assert len(bench.told()) == 2, "it was within its bound meanwhile"


# When it is gone


def test_a_reporter_that_dies_leaves_its_faults_not_tested_and_a_code(bench):
    one, other = bench.enter(pid=77), bench.enter()
    bench.send(one, HOT, "failed")
    bench.send(one, SLOW, "passed")
    bench.send(other, BLIND, "passed")
    bench.leave(one)
    assert bench.results(HOT)[-1] == "not tested"
    assert bench.results(SLOW)[-1] == "not tested"
    assert "not tested" not in bench.results(BLIND)
    assert bench.failing(HOT), "what has failed is not healed by that"
    assert bench.failing(LOST)
    (lost,) = bench.told()
    assert lost["state"] == "lost"
    assert lost["faults"] == [HOT, SLOW]
    assert "process 77" in lost["reason"]
    again = bench.enter()
    bench.send(again, HOT, "passed")
    assert bench.told()[-1]["state"] == "back"
    assert not bench.failing(LOST)
    assert not bench.failing(HOT)


def test_who_says_goodbye_is_not_lost(bench):
    one = bench.enter()
    bench.send(one, HOT, "failed")
    assert bench.packet(one, {"goodbye": True}) == "accepted"
    bench.leave(one)
    assert not bench.told()
    assert "not tested" not in bench.results(HOT)
    assert not bench.failing(LOST)


def test_a_fault_belongs_to_the_connection_that_reported_it_last(bench):
    first, second = bench.enter(), bench.enter()
    bench.send(first, HOT, "failed")
    bench.send(second, HOT, "failed")
    bench.leave(first)
    assert not bench.told()
    bench.leave(second)
    assert bench.told()[-1]["faults"] == [HOT]


def test_who_has_reported_nothing_is_missed_by_nobody(bench):
    bench.leave(bench.enter())
    assert not bench.told()


def test_a_reporter_that_is_due_and_silent_is_lost_goodbye_or_not(tmp_path):
    bench = Bench(tmp_path, battery="alive_ms = 500")  # it has never reported
    assert [event["state"] for event in bench.told()] == ["lost"]
    assert bench.failing(LOST)
    one = bench.enter()
    for _ in range(10):
        bench.wait(300)
        bench.send(one, SLOW, "passed")
    assert [event["state"] for event in bench.told()] == ["lost", "back"]
    bench.packet(one, {"goodbye": True})
    bench.leave(one)
    bench.wait(400)
    assert len(bench.told()) == 2
    bench.wait(300)
    assert [event["state"] for event in bench.told()] == ["lost", "back", "lost"]
    assert bench.results(SLOW)[-1] == "not tested"
    bench.wait(5000)
    assert len(bench.told()) == 3, "once"
    bench.gateway.close()


@pytest.mark.parametrize("reset", ["clear", "restart_cycle"])
def test_the_code_stands_again_after_a_clear_and_in_the_next_operation_cycle(bench, reset):
    one = bench.enter()
    bench.send(one, HOT, "failed")
    bench.leave(one)
    if reset == "clear":
        bench.gateway.controls.clear(0xFFFFFF)
        assert not bench.failing(LOST)
    else:
        bench.gateway.controls.restart_cycle()
    bench.wait(100)
    assert bench.failing(LOST)
    assert not bench.gateway.memory.status(LOST) & Status.NOT_COMPLETED_THIS_CYCLE


def test_the_code_is_told_when_monitoring_is_on_again(bench):
    one = bench.enter()
    bench.send(one, HOT, "passed")
    bench.gateway.controls.set_dtcs(False, "tester")
    bench.leave(one)
    bench.wait(100)
    assert not bench.failing(LOST)
    bench.gateway.controls.set_dtcs(True, "tester")
    bench.wait(100)
    assert bench.failing(LOST)


def test_a_reload_keeps_connections_counts_and_who_is_lost(bench):
    one, other = bench.enter(), bench.enter()
    bench.send(one, HOT, "prefailed")
    bench.send(other, BLIND, "passed")
    bench.leave(other)
    old = bench.gateway
    old.finish(old.engine.now_ns)
    config = load_config(write_config(bench.folder, battery="events_per_s = 50"))
    bench.gateway = Gateway(config, store=old.store)
    bench.gateway.succeed(old)
    bench.wait(100)
    assert bench.failing(LOST)
    bench.send(one, HOT, "prefailed")
    bench.send(one, HOT, "prefailed")
    assert bench.failing(HOT), "what was counted before counts"
    assert bench.gateway.reports.counters() == {"reports_accepted": 4, "reports_refused": 0, "reporters_lost": 1}
    bench.send(bench.enter(), BLIND, "passed")
    assert bench.told()[-1]["state"] == "back"
    assert not bench.failing(LOST)
    bench.leave(one)
    assert bench.told()[-1]["faults"] == [HOT]


def test_who_is_lost_is_forgotten_with_its_table(bench):
    one = bench.enter()
    bench.send(one, BLIND, "passed")
    bench.leave(one)
    old = bench.gateway
    old.finish(old.engine.now_ns)
    path = write_config(bench.folder)
    text = path.read_text()
    path.write_text(text[: text.rindex("[[report.reporter]]")])
    bench.gateway = Gateway(load_config(path), store=old.store)
    bench.gateway.succeed(old)
    bench.wait(100)
    assert not bench.failing(LOST)


def test_without_reporters_as_in_a_replay_the_faults_are_not_tested(tmp_path):
    gateway = Gateway(load_config(write_config(tmp_path)), None)
    gateway.start(0)
    gateway.advance(10**10)
    gateway.stop(10**10)
    for fault in (HOT, SLOW, BLIND, LOST):
        assert gateway.memory.status(fault) & Status.NOT_COMPLETED_SINCE_CLEAR
    assert gateway.summary(1.0)["counters"]["reports_accepted"] == 0
    gateway.close()


# Its table


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        (('name = "camera"', 'name = "a"'), "report.reporter[1].name", "taken by a bus"),
        (('name = "camera"', 'name = "gateway"'), "report.reporter[1].name", "the gateway itself"),
        (('name = "camera"', 'name = "battery"'), "report.reporter[1].name", "taken"),
        (('name = "slow"', 'name = "hot"'), "report.reporter[0].fault[1].name", "taken"),
        (("B1234-00", "P0A7F-00"), "report.reporter[1].fault[0].dtc", "report.reporter[0].fault[1] has this DTC"),
        (("B1234-00", "U3000-44"), 'fault."gateway.memory_not_written".dtc', "camera.blind has this DTC"),
        (("B1234-00", "Q1234"), "report.reporter[1].fault[0].dtc", ""),
        (('"cell"]', '"cell", "cell [V]"]'), "report.reporter[0].fault[0].data", "each name once"),
        (("[report]\n", "[report]\nmode = 0o644\n"), "report", "mode is one of"),
        (('name = "camera"', 'name = "camera"\nevents_per_s = 0'), "report.reporter[1].events_per_s", ""),
        (('name = "camera"', 'name = "camera"\nrate = 5'), "report.reporter[1].rate", "unknown key"),
    ],
)
def test_mistakes_of_the_table_are_named(tmp_path, change, key, words):
    path = write_config(tmp_path)
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change))
    found = mistakes(path)
    assert [error.key for error in found] == [key]
    assert words in found[0].message


def test_a_mode_that_keeps_out_whom_users_let_in_is_refused(tmp_path):
    path = write_config(tmp_path, table="mode = 0o600", battery="users = [5]")
    with pytest.raises(InputErrors, match="keeps everybody out"):
        load_config(path)


def test_a_wrong_table_does_not_make_settings_of_its_faults_wrong(tmp_path):
    path = write_config(tmp_path, table="mood = 5", extra=f'[fault."{HOT}"]\nindicator = true\n')
    assert [error.key for error in mistakes(path)] == ["report.mood"]
