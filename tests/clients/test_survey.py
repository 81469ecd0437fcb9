"""gateway survey against virtual ECUs: who is found, what they say, nothing but reads."""

import importlib

import numpy as np
import pytest

from gateway.bus.frames import EXTENDED, FRAME, empty, payload, put
from gateway.config.load import load_config
from gateway_ask.document import tables
from gateway_ask.survey import LISTEN_NS, Survey
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import load_scenario

cli = importlib.import_module("gateway_ask.cli.survey")  # gateway_ask.cli.survey is the command

MS = 1_000_000
SOME = (*range(0x720, 0x730), 0x7E0, *(EXTENDED | 0x18DA00F1 | k << 8 for k in range(0x3C, 0x42)))
ENGINE = """
[[ecu]]
type = "responder"
name = "engine"
[ecu.uds]
request = 0x7E0
response = 0x7E8
functional = 0x7DF
identifiers = { F190 = "WVWZZZ1JZXW000001", F187 = "03C906016", F186 = "0x01" }
[ecu.uds.answers]
"3E 00" = "7E 00"
"01 00" = "41 00 08 18 00 01"
"01 20" = "41 20 00 02 00 00"
"09 00" = "49 00 40 00 00 00"
[[ecu.uds.dtc]]
code = "P0301-00"
status = 0x2F
"""
BODY = """
[[ecu]]
type = "responder"
name = "body"
[ecu.uds]
request = 0x726
response = 0x72E
delay_ms = {delay}
answers = {{ "3E 00" = "7E 00" }}
identifiers = {{ F18C = "4711" }}
"""
WIDE = """
[[ecu]]
type = "responder"
name = "wide"
[ecu.uds]
request = 0x18DA40F1
response = 0x18DAF140
extended = true
answers = { "03" = "43 01 01 71", "07" = "47 00", "0A" = "4A 00", "3E 00" = "7E 00" }
identifiers = { F18A = "ACME" }
"""
#: A car of model year 2027: OBD on UDS alone.
NEW = """
[[ecu]]
type = "responder"
name = "new"
[ecu.uds]
request = {request}
response = {response}
functional = {functional}
extended = {extended}
[ecu.uds.answers]
"22 F4 00" = "62 F4 00 08 10 00 01"
"22 F4 20" = "62 F4 20 80 00 00 00"
"22 F6 00" = "62 F6 00 C0 00 00 00"
"22 F6 01" = "62 F6 01 80 0B 01 F4 01 2C 02 BC 81 96 FF 38 FE 0C FF 9C"
"22 F6 02" = "62 F6 02 80 0B 03 84 01 2C 02 BC"
"22 F8 00" = "62 F8 00 54 40 00 00"
"22 F8 02" = "62 F8 02 57 56 57 5A 5A 5A 31 4A 5A 58 57 30 30 30 30 30 31"
"22 F8 04" = "62 F8 04 43 41 4C 2D 41 00 00 00 00 00 00 00 00 00 00 00 43 41 4C 2D 42 00 00 00 00 00 00 00 00 00 00 00"
"22 F8 06" = "62 F8 06 12 34 56 78 9A BC DE F0"
"22 F8 0A" = "62 F8 0A 45 43 4D"
"19 42 33 AF FF" = "59 42 33 FF FF 04 02 01 33 00 2F"
"19 55 33" = "59 55 33 FF 04 01 33 00 2F"
"19 02*" = "7F 19 12"
"""


def surveyed(folder, text, *, rate=200.0, traffic=(), until_ns=LISTEN_NS, seconds=60, **options):
    """Run a survey on a bus of virtual ECUs; returns it with the frames that it sent."""
    (folder / "gateway.toml").write_text('[[bus]]\nname = "can"\nuri = "virtual:x"\n')
    file = folder / "s.toml"
    file.write_text(f'name = "s"\nduration_s = {seconds}\nconfig = "gateway.toml"\n' + text)
    scenario = load_scenario(file)
    player = player_of(scenario, load_config(scenario.config))
    made, sent, t_ns = Survey(rate, physical=SOME, **options), [], 0
    while not made.done and t_ns < seconds * 1000 * MS:
        t_ns += 2 * MS
        heard = player.take(t_ns)
        if traffic and t_ns < until_ns:
            heard = np.concatenate([heard, *traffic])
        out = made.poll(t_ns, heard)
        for k in range(len(out)):
            player.hear(out[k : k + 1])
        sent.append(out)
    assert made.done
    return made.found, np.concatenate(sent)


def frame(can_id, data=b"\0" * 8):
    made = empty(1)
    put(made, 0, 0, can_id, data)
    return made


def named(found):
    return {place.name: told for place, told in found.ecus.items()}


def test_ecus_of_11_and_29_bits_are_found_and_say_who_they_are(tmp_path):
    found, _ = surveyed(tmp_path, ENGINE + BODY.format(delay=20) + WIDE)
    ecus = named(found)
    assert set(ecus) == {"ecu_7E0", "ecu_726", "ecu_18DA40F1"}
    engine, body, wide = ecus["ecu_7E0"], ecus["ecu_726"], ecus["ecu_18DA40F1"]
    assert engine.vin == "WVWZZZ1JZXW000001"
    assert engine.parts == {"part number": "03C906016"}
    assert engine.pids == [0x05, 0x0C, 0x0D, 0x2F]
    assert engine.dtcs == {"P0301-00": 0x2F}
    assert engine.services[0x19] is True
    assert body.parts == {"serial number": "4711"}
    assert body.services == {service: service == 0x22 for service in (0x01, 0x03, 0x06, 0x07, 0x09, 0x0A, 0x19, 0x22)}
    assert wide.dtcs == {"P0171": 0x08}
    assert (found.unclear, found.not_tried) == ([], [])


def test_what_is_found_is_a_configuration_that_asks_it(tmp_path, capsys):
    found, _ = surveyed(tmp_path, ENGINE + WIDE)
    (tmp_path / "ecu.toml").write_text(tables(cli._asked(found, 10.0), "obd=virtual:y", "found"))
    ecus = {ecu.name: ecu for ecu in load_config(tmp_path / "ecu.toml").ecu}
    assert [read.key for read in ecus["ecu_7E0"].read] == [(0x01, pid) for pid in (0x05, 0x0C, 0x0D, 0x2F)]
    assert (ecus["ecu_7E0"].dtcs.protocol, ecus["ecu_18DA40F1"].dtcs.protocol) == ("uds", "obd")
    assert ecus["ecu_18DA40F1"].address == 0x40
    facts = cli._facts(found)
    assert facts["ecus"][1]["dtcs"] == [{"dtc": "P0171", "status": 8}]
    cli._say(found, facts)
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 88


@pytest.mark.parametrize("wide", [False, True])
def test_a_car_that_speaks_obd_on_uds_alone_is_found_and_asked_so(tmp_path, wide):
    ids = ("0x18DA40F1", "0x18DAF140", "0x18DB33F1", "true") if wide else ("0x7E0", "0x7E8", "0x7DF", "false")
    names = dict(zip(("request", "response", "functional", "extended"), ids, strict=True))
    found, _ = surveyed(tmp_path, NEW.format(**names))
    (told,) = found.ecus.values()
    assert (told.vin, told.speaks, told.pids) == ("WVWZZZ1JZXW000001", ["obd_on_uds"], [0x05, 0x0C, 0x21])
    assert told.parts == {"calibration": "CAL-A, CAL-B", "verification number": "12345678, 9ABCDEF0", "name": "ECM"}
    assert (told.monitors, told.reads_dtcs, told.dtcs) == ([1, 2], "obd_on_uds", {"P0133-00": 0x12F})
    assert [str(one) for one in told.tests[1]] == [
        "test 80 0.5 V, 0.3 to 0.7: passed",
        "test 81 -20 degC, -50 to -10: passed",
    ]
    assert [(one["value"], one["passed"]) for one in cli._facts(found)["ecus"][0]["tests"]["02"]] == [(0.9, False)]
    (tmp_path / "ecu.toml").write_text(tables(cli._asked(found, 10.0), "obd=virtual:y", "found"))
    (ecu,) = load_config(tmp_path / "ecu.toml").ecu
    assert (ecu.protocol, ecu.dtc_protocol, ecu.finds_protocol) == ("obd_on_uds", "obd_on_uds", False)
    assert [read.key for read in ecu.read] == [(0x01, 0x05), (0x01, 0x0C), (0x01, 0x21)]


def test_it_only_reads_and_keeps_its_rate(tmp_path):
    _, sent = surveyed(tmp_path, ENGINE + BODY.format(delay=20), rate=50.0)
    asked = sent[(sent["data"][:, 0] >> 4) == 0]
    asked = asked[asked["can_id"] != EXTENDED | 0x18EAFFFE]
    assert {int(each) for each in asked["data"][:, 1]} <= {0x01, 0x03, 0x06, 0x07, 0x09, 0x0A, 0x19, 0x22, 0x3E}
    assert np.diff(asked["t_ns"]).min() >= 20 * MS
    rest = sent[(sent["data"][:, 0] >> 4) != 0]
    assert {int(each) for each in rest["data"][:, 0]} <= {0x30}  # flow control
    assert sent.dtype == FRAME


def test_a_slow_ecu_is_not_taken_for_the_next_address(tmp_path):
    """Its answer comes while the next address is asked: that one does not answer again."""
    found, _ = surveyed(tmp_path, BODY.format(delay=150))
    assert set(named(found)) <= {"ecu_726"}
    assert found.unclear


def test_identifiers_with_traffic_are_not_asked_and_are_told(tmp_path):
    found, sent = surveyed(tmp_path, ENGINE, traffic=[frame(0x726), frame(0x100)])
    assert found.not_tried == [0x726]
    assert 0x726 not in sent["can_id"]
    assert found.frames > 100


def test_traffic_that_looks_like_an_answer_is_none(tmp_path):
    alike = [frame(0x650, bytes.fromhex("037f223100000000")), frame(0x650, bytes.fromhex("027e000000000000"))]
    found, _ = surveyed(tmp_path, ENGINE, traffic=alike, until_ns=60_000 * MS)
    assert set(named(found)) == {"ecu_7E0"}
    assert found.unclear == []


def test_nothing_is_sent_where_nobody_agrees(tmp_path):
    found, sent = surveyed(tmp_path, ENGINE, traffic=[frame(0x100)], may_ask=lambda found: not found.frames)
    assert len(sent) == 0
    assert not found.ecus


@pytest.mark.long
@pytest.mark.parametrize("kind", ["mute", "pending", "sequence", "reset", "echo", "refuse", "slow"])
def test_ecus_with_faults_end_it_too(tmp_path, kind):
    by_ms = 50 if kind == "pending" else 400
    faults = f'[[fault]]\necu = "engine"\nkind = "{kind}"\nfrom_s = 4.85\nby_ms = {by_ms}\n'
    faults += 'request = "01 05"\nnumber = 3\n' if kind == "reading" else ""
    found, sent = surveyed(tmp_path, ENGINE + BODY.format(delay=20) + faults, rate=50.0, seconds=400)
    assert "ecu_726" in named(found)
    assert named(found)["ecu_726"].parts == {"serial number": "4711"}
    engine = named(found).get("ecu_7E0")
    if kind in ("mute", "pending"):
        assert set(engine.services.values()) == {None}  # not known, rather than not there
    assert payload(sent[0])


def test_j1939_names_and_dtcs():
    made = Survey(200.0)
    made.poll(0, frame(EXTENDED | 0x18FECA21, bytes.fromhex("04ff6e0003010000")))
    made.poll(LISTEN_NS, empty(0))
    claim = frame(EXTENDED | 0x18EEFF3D, bytes.fromhex("0102030405060708"))
    made.poll(LISTEN_NS + 100 * MS, claim)
    made.poll(LISTEN_NS + 400 * MS, empty(0))
    assert made.found.active == {0x21: ["SPN 110 FMI 3"]}
    assert made.found.names == {0x3D: 0x0807060504030201}
