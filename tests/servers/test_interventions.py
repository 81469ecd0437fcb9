"""The trace of what testers did: who, what, when, what came of it; kept, bounded, told, and read (D4)."""

import json
import struct

import pytest
from rig import FUNCTIONAL, Rig, Tester, write_config
from test_access import LEVEL, OPEN, SERVERS, STANDS, by_j1939, by_mode_04, unlock
from uds_tester import EXTRA, Asked

from gateway.faults import service
from gateway.faults.interventions import DONE, MOST, Intervention, Interventions
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.store import StoreError
from gateway_commands.faults import interventions as shown


def told(rig):
    return [event for event in rig.events if event["event"] == "intervention"]


def kept(rig):
    rig.wait(1)
    return [
        (each.protocol, each.address, each.session, each.security, each.action, each.outcome)
        for each in rig.gateway.memory.interventions()
    ]


@pytest.mark.evidence("Nothing is silent: interventions")
@pytest.mark.parametrize(
    ("request_", "action"),
    [
        ("1101", "reset"),
        ("14ffffff", "clear"),
        ("280301", "communication"),
        ("2e01240a0b", "write"),
        ("31010201", "routine"),
        ("31010202", "routine"),
        ("8502", "dtc_setting"),
    ],
)
def test_every_intervention_leaves_a_trace(uds, tmp_path, request_, action):
    rig, ask = uds(memory=tmp_path / "m.sqlite")
    assert ask("1003")
    assert "7f" not in ask(request_)[:2] or request_ == "31010202"
    assert kept(rig)[0] == ("uds", 0x7E0, 3, 0, action, DONE)
    event = told(rig)[0]
    assert event["t_ns"] <= rig.now
    assert (event["bus"], event["address"], event["action"]) == ("b", 0x7E0, action)
    assert bytes.fromhex(request_).startswith(bytes.fromhex(event["request"]))
    assert event["outcome"] == "done"
    (found, *_) = service.interventions(tmp_path / "m.sqlite")
    assert found["action"] == action


def test_reading_leaves_none(uds):
    rig, ask = uds()
    for request in ("1003", "1902ff", "22f190", "3e00", "2701", "1001", "10"):
        ask(request)
    assert kept(rig) == []


def test_what_was_refused_is_told_with_its_reason(uds):
    rig, ask = uds(uds=LEVEL, more=STANDS)
    ask("14ffffff")
    ask("1003")
    ask("8502")
    unlock(ask)
    ask("280301")
    assert [(action, level, nrc) for _, _, _, level, action, nrc in kept(rig)] == [
        ("clear", 0, 0x7F), ("dtc_setting", 0, 0x33), ("unlock", 0, DONE), ("communication", 1, 0x22),
    ]  # fmt: skip
    assert [event["outcome"] for event in told(rig)] == ["refused", "refused", "done", "refused"]


def test_wrong_keys_and_a_lockout_are_told(uds):
    rig, ask = uds(uds=LEVEL.replace(" }", ", attempts = 2 }"))
    ask("1003")
    for _ in range(2):
        ask("2701")
        ask("270200000000")
    assert [(action, nrc) for *_, action, nrc in kept(rig)] == [("unlock", 0x35), ("unlock", 0x36), ("lockout", 0x36)]
    assert told(rig)[-1]["action"] == "lockout"


def test_how_long_the_gateway_was_blind_can_be_seen(uds):
    rig, ask = uds()
    ask("1003")
    ask("8502")
    rig.wait(5100)
    assert [(protocol, action) for protocol, _, _, _, action, _ in kept(rig)] == [
        ("uds", "dtc_setting"), ("gateway", "dtc_setting_ended"),
    ]  # fmt: skip
    begun, ended = (event["t_ns"] for event in told(rig))
    assert 5.0e9 <= ended - begun <= 5.1e9


def test_other_protocols_and_other_processes_leave_one_too(uds, tmp_path):
    path = tmp_path / "m.sqlite"
    rig, _ = uds(uds=OPEN, more=SERVERS, memory=path)
    rig.wait(300)
    by_mode_04(rig)
    by_j1939(rig, 0xFED3)
    assert kept(rig) == [
        ("obd", FUNCTIONAL, 0, 0, "obd_clear", 0x22), ("j1939", 0x21, 0, 0, "j1939_clear", 0x33),
    ]  # fmt: skip
    rig.close()
    rig, _ = uds(more=SERVERS, memory=path)
    rig.wait(300)
    by_mode_04(rig)
    by_j1939(rig, 0xFED3)
    assert [nrc for *_, nrc in kept(rig)][2:] == [DONE, DONE]
    rig.close()
    service.clear(path)
    assert [each["protocol"] for each in service.interventions(path)][-1] == "local"


def test_a_functional_request_is_told_as_such(uds):
    rig, ask = uds(uds="clear = {}")
    ask("14ffffff", functional=FUNCTIONAL)
    assert kept(rig) == [("uds", FUNCTIONAL, 1, 0, "clear", DONE)]


def test_the_trace_survives_a_restart_and_a_clear(uds, tmp_path):
    rig, ask = uds(memory=tmp_path / "m.sqlite")
    ask("1003")
    ask("14ffffff")
    ask("8502")
    rig.wait(10)
    rig.gateway.store.close()  # as kill -9: nothing is ended
    rig, ask = uds(memory=tmp_path / "m.sqlite")
    assert [action for *_, action, _ in kept(rig)] == ["clear", "dtc_setting"]
    ask("1003")
    ask("8502")
    assert [each.number for each in rig.gateway.memory.interventions()] == [1, 2], "alike in a row: one record"
    assert rig.gateway.memory.interventions()[-1].count == 2


@pytest.mark.evidence("Nothing is silent: floods")
def test_a_flood_of_refusals_is_counted_not_written(uds, tmp_path):
    rig, _ = uds(memory=tmp_path / "m.sqlite")
    before = rig.gateway.memory.commits
    for _ in range(200):
        rig.feed((0x7E0, bytes.fromhex("021101")))
    assert rig.gateway.memory.commits - before <= 9
    assert len(told(rig)) <= 9
    rig.gateway.stop(rig.now)
    (found,) = service.interventions(tmp_path / "m.sqlite")
    assert found["count"] == 200


def test_what_is_refused_cannot_have_what_was_done_forgotten():
    trace = Interventions()
    done = [Intervention(k, "uds", "b", 0x7E0 + k, "clear") for k in range(MOST)]
    for each in done[: MOST // 2]:
        trace.note(each)
    for k in range(5000):
        trace.note(Intervention(k, "uds", "b", k, "clear", outcome=0x33))
    assert len(trace.all()) == MOST
    assert [each.address for each in trace.all() if each.outcome == DONE] == [e.address for e in done[: MOST // 2]]
    for each in done:
        trace.note(each)
    assert len(trace.all()) == MOST


@pytest.mark.evidence("Bounded: trace")
def test_the_trace_is_bounded_in_the_file_and_in_an_outage(uds, tmp_path, monkeypatch):
    path = tmp_path / "m.sqlite"
    rig, _ = uds(memory=path)
    memory = rig.gateway.memory

    def note(first, last):
        for k in range(first, last):
            memory.ledger.note_intervention(Intervention(k, "uds", "b", k, "clear"))

    def stored():
        return [each["address"] for each in service.interventions(path)]

    note(0, 150)
    assert memory.commit(rig.now, final=True)
    note(150, 350)
    assert memory.commit(rig.now, final=True)
    assert stored() == list(range(350 - MOST, 350))

    write = ResilientStore.save

    def broken(*_):
        raise StoreError(path, "no")

    monkeypatch.setattr(ResilientStore, "save", broken)
    note(350, 2000)
    assert not memory.commit(rig.now, final=True)
    note(2000, 3000)
    assert len(memory.ledger._pending.interventions) <= MOST
    monkeypatch.setattr(ResilientStore, "save", write)
    assert memory.commit(rig.now, final=True)
    assert stored() == list(range(3000 - MOST, 3000))


def test_the_identifier_reads_the_latest(uds):
    _, ask = uds(uds=LEVEL)
    assert ask("22fd10") == "62fd1000"
    ask("1003")
    ask("8502")
    unlock(ask)
    ask("14ffffff")
    data = bytes.fromhex(ask("22fd10"))[3:]
    assert data[0] == 3
    records = [struct.unpack(">qqHBIBBB7sB", data[1 + 34 * k : 35 + 34 * k]) for k in range(3)]
    assert [record[7] for record in records] == [0x14, 0x27, 0x85], "services, the latest first"
    assert records[0][2:7] == (1, 1, 0x7E0, 3, 1)
    assert records[0][8] == bytes.fromhex("14ffffff000000")
    assert [record[9] for record in records] == [0, 0, 0x33]
    assert records[0][0] == records[0][1] > records[2][1] > 0


def test_the_identifier_can_be_moved_or_left_out(tmp_path):
    for text, number, answer in (("0xFD20", "22fd20", "62fd2000"), ("0xFD20", "22fd10", "7f2231")):
        rig = Rig(write_config(tmp_path, extra=f"[output.uds]\n[access]\ntrace_did = {text}\n"))
        assert Tester(rig).ask(number).hex() == answer
        rig.close()
    taken = EXTRA.format(uds="") + '[[did]]\nid = 0xFD10\nname = "x"\ntext = "x"\n'
    with pytest.raises(Exception, match="trace_did"):
        Rig(write_config(tmp_path, extra=taken))


def test_the_command_line_lists_it(uds, tmp_path, capsys):
    rig, ask = uds(memory=tmp_path / "m.sqlite")
    ask("1003")
    ask("1101")
    ask("1101")
    rig.wait(1)
    capsys.readouterr()
    assert shown(None, memory=tmp_path / "m.sqlite", json=True) == 0
    first, second = json.loads(capsys.readouterr().out)
    assert (first["action"], first["outcome"], second["nrc"]) == ("reset", "done", 0x7F)
    assert shown(None, memory=tmp_path / "m.sqlite", json=False) == 0
    said = capsys.readouterr().out
    assert "uds 7E0 on b" in said
    assert "refused 0x7F" in said


def test_a_damaged_file_gives_back_what_can_be_read(uds, tmp_path):
    path = tmp_path / "m.sqlite"
    rig, ask = uds(memory=path)
    ask("1003")
    ask("1101")
    rig.wait(1)
    rig.close()
    import sqlite3

    db = sqlite3.connect(path)
    db.execute("PRAGMA foreign_keys = OFF")
    db.execute("INSERT INTO freeze_frame VALUES ('nobody', 1, 0, '{}')")
    db.execute("INSERT INTO intervention SELECT 7, first_ns, t_ns, count, 'nonsense', bus, address, session, security,"
               " role, action, request, outcome FROM intervention")  # fmt: skip
    db.commit()
    db.close()
    store = ResilientStore(path)
    assert [each.action for each in store.interventions()] == ["reset"]
    assert store.incidents()[0].lost == 2
    store.close()


def test_a_file_of_before_is_brought_up_to_date(tmp_path):
    import sqlite3

    from gateway.faults.schema import APPLICATION_ID, MIGRATIONS

    path = tmp_path / "old.sqlite"
    db = sqlite3.connect(path)
    db.executescript("".join(MIGRATIONS[:4]) + f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = 4;")
    db.close()
    assert service.interventions(path) == []
    rig = Rig(write_config(tmp_path, extra=EXTRA.format(uds="")), path)
    ask = Asked(rig)
    ask("1003")
    ask("1101")
    rig.close()
    assert [each["action"] for each in service.interventions(path)] == ["reset"]
