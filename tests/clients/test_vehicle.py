"""DTCs of other ECUs: came, changed, went; what an answer does not say is not concluded; kept over restarts."""

import json
import sqlite3

import numpy as np
import pytest
from asking_rig import BUS, Car, Ecu, settled, write

from gateway.config.load import load_config
from gateway.faults.store import Store
from gateway.faults.vehicle import MOST, PERMANENT, DtcAnswer, VehicleMemory
from gateway.runtime.app import Gateway
from gateway_ask.clients.dtcs import details_of, read_dtcs
from gateway_fdi.errors import GatewayError
from gateway_replay.replay import replay

SEED = 3
UDS = """
[[ecu]]
name = "brake"
request = 0x7E0
response = 0x7E8
dtcs = { every_s = 1 }
[[ecu.fault]]
name = "any"
of = "C0035"
dtc = "U1234-00"
[clock]
watched = false
"""


def told(answer, request="1902AF"):
    return read_dtcs("e", bytes.fromhex(answer), bytes.fromhex(request))


def test_answers_are_read():
    assert told("5902FF 400011 2F 010203 08") == DtcAnswer("e", {"C0000-11": 0x2F, "P0102-03": 8}, 0xAF)
    assert told("5902FF", "1902FF") == DtcAnswer("e", {}, 0xFF)
    for request in ("", "190F2F", "1901FF", "03", "1902"):
        assert told("5902FF", request).covers == 0
    assert told("590AFF 400011 2F").covers == 0
    assert told("4302 0133 4035") == DtcAnswer("e", {"P0133": 8, "C0035": 8}, 8, whole=False)
    assert told("4301 0133 0000").found == {"P0133": 8}
    assert told("4303 0133").covers == 0  # cut
    assert told("4A00") == DtcAnswer("e", {}, PERMANENT, whole=False)
    assert told("5904 400011 2F 01 02 F190 31").data == {"C0000-11": "0102F19031"}
    assert [told(text) for text in ("7F1931", "62F19001", "59", "5904400011", "43")] == [None] * 5
    assert details_of("C0000-11") == (bytes.fromhex("1904400011FF"), bytes.fromhex("1906400011FF"))


def test_dtcs_are_the_same_by_each_report_of_uds():
    """By mask; of the emission system by mask and severity, permanent, by a readiness group (1)."""
    two = ("400011", "010203")
    plain = told("5902FF" + "".join(f"{dtc} 2F" for dtc in two))
    assert told("595633FF0401" + "".join(f"{dtc} 2F" for dtc in two), "19563301").found == plain.found
    assert told("594233FFFF04" + "".join(f"04 {dtc} 2F" for dtc in two), "194233AFFF").found == plain.found
    assert told("595533FF04" + "".join(f"{dtc} 2F" for dtc in two)).found == dict.fromkeys(plain.found, PERMANENT)
    assert told("595633FF0401", "19563301") == DtcAnswer("e", {}, 0)  # of one readiness group: no other is cleared


def states(memory, answer, request="1902AF", t_ns=0):
    _, events = memory.take(told(answer, request), t_ns)
    return [(dtc.dtc, state) for dtc, state in events]


def test_a_dtc_comes_changes_and_goes_only_by_what_is_told():
    memory = VehicleMemory()
    assert states(memory, "5902FF 400011 2F", t_ns=1) == [("C0000-11", "came")]
    assert states(memory, "5902FF 400011 2F", t_ns=2) == []
    assert states(memory, "5902FF", "190208", t_ns=3) == [("C0000-11", "changed")]  # it is not confirmed any more
    assert states(memory, "5902FF", "", t_ns=4) == []  # nobody knows which DTCs were asked for
    assert states(memory, "5902FF", t_ns=5) == [("C0000-11", "went")]
    assert states(memory, "5902FF 400011 50", "1902FF", t_ns=6) == []  # not tested: it is not there
    assert states(memory, "5902FF 400011 08", t_ns=7) == [("C0000-11", "came")]
    (dtc,) = memory.all()
    assert (dtc.came, dtc.first_ns, dtc.last_ns, dtc.went_ns, dtc.there) == (2, 1, 7, 5, True)
    assert states(memory, "4301 0133", "03") == [("P0133", "came")]
    assert states(memory, "4701 0133", "07") == [("P0133", "changed")]
    assert states(memory, "4300", "03") == [("P0133", "changed")]
    assert states(memory, "4700", "07") == [("P0133", "went")]


def test_no_more_are_kept_than_there_is_room_for():
    print("seed", SEED)
    memory, rng = VehicleMemory(), np.random.default_rng(SEED)
    for _ in range(4):
        found = {f"P{k:04X}-00": 8 for k in rng.permutation(0x4000)[: MOST // 2 + 300]}
        memory.take(DtcAnswer(f"e{rng.integers(3)}", found, 0), 0)
    assert len(memory.all()) == MOST
    assert memory.dropped > 0
    memory.take(DtcAnswer("e0", {}, 0x1FF), 5)
    memory.take(DtcAnswer("new", {"C0001-00": 8}, 0), 6)
    assert len(memory.all()) == MOST
    assert "C0001-00" in [each.dtc for each in memory.all()]


@pytest.fixture
def brake(tmp_path):
    """A car whose brakes have DTCs, in a file."""
    dtcs = {"text": "400011 2F 400022 50"}

    def answer(request):
        if request[1] == 2:
            return [(3, bytes.fromhex("5902FF" + dtcs["text"]))]
        if request[1] == 4:
            return [(3, b"\x59\x04" + request[2:5] + b"\x2f\x01\x01\xf1\x90\x31")]
        return [(3, b"\x7f\x19\x31")]

    file = write(tmp_path, BUS + UDS.replace("C0035", "C0000-11"))
    made = Car(file, [Ecu(0x7E0, 0x7E8, answer)], memory=tmp_path / "memory.sqlite")
    yield made, dtcs, file
    made.close()


def test_dtcs_are_asked_for_told_stored_and_stand_for_a_fault_of_ours(brake, tmp_path):
    made, dtcs, file = brake
    made.run(3000)
    events = [(e["ecu"], e["dtc"], e["state"]) for e in made.events if e["event"] == "ecu_dtc"]
    assert events == [("brake", "C0000-11", "came")]
    assert [e["dtc"] for e in made.events if e["event"] == "dtc"][:1] == ["U1234-00"]
    assert [data[:2].hex() for *_, data in made.requests][:4] == ["1902", "1904", "1906", "1902"]
    (known,) = Store(tmp_path / "memory.sqlite", write=False).ecu_dtcs()
    assert (known.dtc, known.status, known.there, known.came) == ("C0000-11", 0x2F, True, 1)
    assert known.snapshots == {"1904": "0101F19031"}
    assert settled(made.state())
    dtcs["text"] = ""
    made.run(2000)
    assert [e["state"] for e in made.events if e["event"] == "ecu_dtc"] == ["came", "went"]
    assert made.gateway.memory.status_now("brake.any") & 1 == 0
    made.gateway.stop(made.now)
    made.gateway.close()
    made.gateway = Gateway(load_config(file), tmp_path / "memory.sqlite", file=file)
    (known,) = made.gateway.memory.vehicle.all()
    assert (known.there, known.came, known.went_ns is not None) == (False, 1, True)


def test_a_log_tells_the_same(brake):
    made, dtcs, file = brake
    for text in ("400011 2F", "", "400011 2F 400033 08", "400033 09"):
        dtcs["text"] = text
        made.run(2500)
    made.gateway.stop(made.now)
    again, events = Gateway(load_config(file), file=file), []
    again.listen(events.append)
    frames = made.recording()
    replay(again, np.array_split(frames, 7))
    kinds = ("dtc", "ecu_dtc")
    live = [e for e in made.events if e["event"] in kinds]
    assert [e for e in events if e["event"] in kinds] == live
    assert len(live) > 6
    assert again.memory.vehicle.all() == made.gateway.memory.vehicle.all()


def test_nothing_is_asked_unless_its_conditions_are_met(tmp_path):
    dbc = 'VERSION ""\nBU_: A\nBO_ 256 State: 1 A\n SG_ Speed : 0|8@1+ (1,0) [0|255] "km/h" A\n'
    (tmp_path / "state.dbc").write_text(dbc)
    when = 'dtcs = { every_s = 1, when = [{ signal = "State.Speed", max = 0 }] }'
    toml = UDS.replace("dtcs = { every_s = 1 }", when)
    made = Car(write(tmp_path, BUS + 'database = ["state.dbc"]\n' + toml), [Ecu(0x7E0, 0x7E8, lambda _: [])])
    assert made.run(3000).requests == []
    assert made.run(3000, *[(k, 0x100, b"\x20") for k in range(0, 3000, 100)]).requests == []
    assert len(made.run(3000, *[(k, 0x100, b"\x00") for k in range(0, 3000, 100)]).requests) in (1, 2, 3)


def test_names_of_faults_are_theirs_alone(tmp_path):
    for wrong, text in (
        (UDS.replace('"brake"', '"obd"'), "this name is taken"),
        (UDS.replace('of = "C0035"', 'of = "X0035"'), "fault[0].of"),
    ):
        with pytest.raises(GatewayError, match="taken|of") as error:
            load_config(write(tmp_path, BUS + wrong))
        assert text in str(error.value)


def test_people_and_programs_see_them(brake, tmp_path, capsys):
    from typer.testing import CliRunner

    from gateway.cli import app

    made, _, file = brake
    made.run(2000)
    made.gateway.stop(made.now)
    run = CliRunner()
    memory = ["--memory", str(tmp_path / "memory.sqlite")]
    shown = run.invoke(app, ["faults", "list", *memory, "--ecu", "brake"]).stdout
    assert "C0000-11" in shown
    assert "1904: 0101F19031" in shown
    assert (
        "no DTCs of other ECUs; the ECUs with DTCs are brake"
        in run.invoke(app, ["faults", "list", *memory, "--ecu", "break"]).stdout
    )
    (known,) = json.loads(run.invoke(app, ["faults", "list", *memory, "--ecu", "all", "--json"]).stdout)
    assert (known["ecu"], known["there"]) == ("brake", True)
    checked = run.invoke(app, ["check", str(file)]).stdout
    assert "asks brake (0x7E0, 0x7E8) on obd: DTCs (uds) every 1 s" in checked
    assert "U1234-00  brake.any" in checked


def test_metrics_and_the_broker_have_them():
    from pathlib import Path

    from gateway_serve.broker import Broker
    from gateway_serve.hub import Hub
    from gateway_serve.metrics import Metrics
    from gateway_serve.mqtt import Published, Publisher

    hub = Hub(Path("none"))
    hub.ecus = [{"ecu": "brake", "requests": 7, "answers": 5, "absent": 2, "not_asked": {}}]
    one = {"ecu": "brake", "dtc": "C0035-11", "there": True, "status": 8}
    hub.memory["ecu_dtcs"] = [one, {**one, "dtc": "C0036-11", "there": False}]
    text = Metrics(hub).text().decode()
    assert 'gateway_ecu_requests_total{ecu="brake"} 7.0' in text
    assert 'gateway_ecu_outcomes_total{ecu="brake",outcome="absent"} 2.0' in text
    assert 'gateway_ecu_dtc{dtc="C0036-11",ecu="brake"} 0.0' in text
    states = Publisher(hub, Broker(host="none"), Published(), "car").states()
    assert [topic for topic in states if "/ecu/" in topic] == ["gateway/car/ecu/brake/dtc/C0035-11"]


@pytest.mark.parametrize("listening", [True, False])
def test_dtcs_that_are_broadcast_are_kept_without_asking(tmp_path, listening):
    from gateway.j1939.frame import GLOBAL, Pdu
    from gateway.j1939.transport import Transport
    from gateway_testers.j1939.messages import dtc_bytes

    dtcs = [dtc_bytes(100, 3, 1), dtc_bytes(0x7FFFE, 31, 1)]
    engine = Transport(0x00)
    toml = BUS + ("dm1 = true\n" if listening else "") + "[clock]\nwatched = false\n"
    toml += '[[ecu]]\nname = "engine"\naddress = 0\nread = [{ pgn = 65260, every_ms = 86_400_000 }]\n'
    made = Car(write(tmp_path, toml))

    def say(transport, coded):
        pdus = transport.send(0xFECA, b"\x04\xff" + (b"".join(coded) or bytes(4)), GLOBAL, made.now)
        while pdus:
            for pdu in pdus:
                made.say(pdu.can_id, pdu.data)
            made.run(60)
            pdus = transport.on_time(made.now)

    say(engine, dtcs)
    say(Transport(0x21), dtcs[:1])
    say(engine, dtcs[:1])
    say(Transport(0x21), [])
    told = [(e["ecu"], e["dtc"], e["state"]) for e in made.events if e["event"] == "ecu_dtc"]
    wanted = [
        ("engine", "SPN 100 FMI 3", "came"),
        ("engine", "SPN 524286 FMI 31", "came"),
        ("obd:21", "SPN 100 FMI 3", "came"),
        ("engine", "SPN 524286 FMI 31", "went"),
        ("obd:21", "SPN 100 FMI 3", "went"),
    ]
    assert told == (wanted if listening else [])
    assert [can_id for _, can_id, _ in made.sent] == [0x98EA00F9]  # what was asked for, and nothing for DM1
    assert Pdu(0xFECA, 0x21, GLOBAL, b"").can_id == 0x98FECA21


def test_they_are_recovered_from_a_damaged_file(brake, tmp_path):
    made, _, file = brake
    made.run(2000)
    made.gateway.stop(made.now)
    known = made.gateway.memory.vehicle.all()
    made.gateway.close()
    path = tmp_path / "memory.sqlite"
    db = sqlite3.connect(path, isolation_level=None)
    db.execute("UPDATE fault SET status = status + 1")  # not by a gateway
    db.execute("INSERT INTO ecu_dtc VALUES ('brake', 'x', 1, 1, 1, 1, 1, NULL, 'no JSON')")
    db.close()
    made.gateway = Gateway(load_config(file), path, file=file)
    assert made.gateway.memory.vehicle.all() == known != []
    assert list(tmp_path.glob("memory.sqlite.damaged-*"))
