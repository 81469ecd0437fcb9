"""ECUs that are asked, their signals and faults; our own servers as ECUs; a log of it replays to the same."""

import random

import numpy as np
import pytest
import udsoncan
from asking_rig import BUS, MS, Car, Ecu, Server, settled, write
from recorded_wire import dissect, write_pcap
from rig import Rig, Tester, dtc_text, write_config
from udsoncan.services import ReadDTCInformation

from gateway.bus.frames import OWN, payload
from gateway.bus.logs import LogReader, open_writer
from gateway.common.times import NEVER
from gateway.config.load import load_config
from gateway.faults.dtc import Dtc
from gateway.runtime.app import Gateway
from gateway_ask.clients.ecu import Ask
from gateway_replay.replay import replay

SEED = 5
LOW = "cell.Last.low"
BATTERY = """
[[ecu]]
name = "battery"
request = 0x7E4
response = 0x7EC
signals = ["cells.dbc"]
read = [{ did = 0x2101, every_ms = 500 }, { did = 0x1111, every_ms = 500 }]
check = [{ message = "Cells", timeout_ms = 1500 }]
[[ecu]]
name = "engine"
request = 0x7E0
response = 0x7E8
read = [{ pid = 0x0C, every_ms = 300 }]
[[monitor]]
name = "cell"
type = "signal"
bus = "answers:obd"
signal = [{ signal = "Cells_3.Last", plausible = [2.8, 4.3] }]
[fault."cell.Last.low"]
freeze_frame = ["Cells.First", "A_010C.RPM"]
[clock]
watched = false
[memory]
recording = { before_ms = 2000.0, after_ms = 200.0 }
"""


def cells(first, last):
    return b"\x62\x21\x01" + round(first * 1000).to_bytes(2, "big") + bytes(146) + round(last * 1000).to_bytes(2, "big")


@pytest.fixture
def battery(tmp_path):
    """A car whose battery has a cell that empties, and whose ECU dies."""
    last = {"volts": 3.7, "alive": True}

    def answer(request):
        if not last["alive"]:
            return []
        if request == b"\x22\x21\x01":
            return [(5, cells(3.7, last["volts"]))]
        return [(3, b"\x62" + request[1:] + b"\x01\x02")]

    file = write(tmp_path, BUS + BATTERY)
    ecus = [Ecu(0x7E4, 0x7EC, answer), Ecu(0x7E0, 0x7E8, lambda _: [(3, bytes.fromhex("410C1AF8"))])]
    made = Car(file, ecus)
    yield made, last, file
    made.close()


def drive(made, last):
    made.run(3000)
    last["volts"] = 2.5
    made.run(3000)
    last["alive"] = False
    made.run(4000)


def test_signals_of_answers_are_monitored_and_silence_is_told(battery):
    made, last, _ = battery
    drive(made, last)
    assert made.value("answers:obd.Cells_3.Last") == 2.5
    dtcs = [(e["bus"], e["fault"]) for e in made.events if e["event"] == "dtc" and e["status"] & 1]
    assert dtcs == [("answers:obd", LOW), ("answers:obd", "answers:obd.Cells.timeout")]
    (entry,) = [one for one in made.gateway.memory.entries() if one.fault == LOW]
    assert entry.freeze_frames[0].content == {"Cells.First": 3.7, "A_010C.RPM": 1726.0}
    counters = made.gateway.summary(1.0)["counters"]
    assert counters["ecu_requests"] == len(made.requests)
    assert counters["ecu_answers_unknown"] > 10  # 0x1111 has no layout
    for k in (0, 1):
        assert settled(made.state(k))


def relevant(events):
    return [event for event in events if event["event"] != "summary"]


@pytest.mark.evidence("Live is replay: answers")
@pytest.mark.parametrize("own", ["with our requests", "without them", "as another tester's"])
def test_a_log_replays_to_the_live_verdict(battery, own, tmp_path):
    made, last, file = battery
    drive(made, last)
    made.gateway.stop(made.now)
    frames = made.recording()
    if own == "without them":
        frames = frames[frames["flags"] & OWN == 0]
    elif own != "with our requests":
        frames["flags"] = 0
    with open_writer(tmp_path / "drive.log") as log:
        log.write(frames)
    again, events = Gateway(load_config(file), file=file), []
    again.listen(events.append)
    replay(again, LogReader(tmp_path / "drive.log"))
    told = [event for event in made.events if event["event"] in ("dtc", "monitor", "diagnosis")]
    assert [e["fault"] for e in told if e["event"] == "dtc" and e["status"] & 1] == [LOW, "answers:obd.Cells.timeout"]
    assert [event for event in events if event["event"] in ("dtc", "monitor", "diagnosis")] == told
    recordings = [list(each.store.recordings()) for each in (made.gateway, again)]
    assert (
        [one.fault for one in recordings[0]]
        == [one.fault for one in recordings[1]]
        == [LOW, "answers:obd.Cells.timeout"]
    )


def test_a_recording_of_a_fault_replays_to_that_fault(battery, tmp_path):
    import zlib

    made, last, file = battery
    drive(made, last)
    (recording,) = made.gateway.store.recordings(LOW)
    (tmp_path / "fault.log").write_bytes(zlib.decompress(recording.log))
    again, events = Gateway(load_config(file), file=file), []
    again.listen(events.append)
    replay(again, LogReader(tmp_path / "fault.log"))
    assert LOW in [event["fault"] for event in events if event["event"] == "dtc"]


def test_a_reload_goes_on_where_it_stopped(battery):
    made, _, file = battery
    made.run(2000)
    old = made.gateway
    old.finish(made.now)
    made.gateway = Gateway(load_config(file), file=file, store=old.store)
    made.gateway.succeed(old)
    made.gateway.listen(made.events.append)
    before = made.state()["requests"]
    made.run(1000)
    assert before >= 8
    assert made.state()["requests"] - before == 4
    assert settled(made.state())
    assert made.value("answers:obd.Cells_3.Last") == 3.7


FAULTS = {
    k: f'emission_related = true\nindicator = true\nfreeze_frame = ["M{k}.Value"]\nseverity = "maintenance"\n'
    for k in range(3)
}
SERVER = """
[output.uds]
[output.obd]
vin = "1HGCM82633A004352"
calibration = "GW-1"
calibration_check = 0x1234ABCD
ecu_name = "GATEWAY"
pid = [{ id = 0x0C, signal = "M0.Value" }]
[[did]]
id = 0xF190
name = "vin"
text = "1HGCM82633A004352"
"""


def test_our_own_servers_as_ecus_give_what_udsoncan_reads(tmp_path):
    rig = Rig(write_config(tmp_path, 3, extra=SERVER, faults=FAULTS))
    rig.value(0, 12.5)
    rig.fail(0)
    rig.fail(1)
    rig.cycle(1)
    first = udsoncan.Dtc(int.from_bytes(bytes(Dtc.parse(dtc_text(0))), "big"))
    reports = ReadDTCInformation.Subfunction
    asked = [
        ReadDTCInformation.make_request(reports.reportNumberOfDTCByStatusMask, status_mask=0xFF),
        ReadDTCInformation.make_request(reports.reportDTCByStatusMask, status_mask=0xFF),
        ReadDTCInformation.make_request(reports.reportDTCSnapshotIdentification),
        ReadDTCInformation.make_request(
            reports.reportDTCSnapshotRecordByDTCNumber, dtc=first.id, snapshot_record_number=0xFF
        ),
        ReadDTCInformation.make_request(reports.reportDTCSnapshotRecordByRecordNumber, snapshot_record_number=1),
        ReadDTCInformation.make_request(
            reports.reportDTCExtendedDataRecordByDTCNumber, dtc=first.id, extended_data_record_number=0xFF
        ),
        ReadDTCInformation.make_request(
            reports.reportNumberOfDTCBySeverityMaskRecord, status_mask=0xFF, severity_mask=0xE0
        ),
        ReadDTCInformation.make_request(reports.reportDTCBySeverityMaskRecord, status_mask=0xFF, severity_mask=0xE0),
        ReadDTCInformation.make_request(reports.reportSeverityInformationOfDTC, dtc=first.id),
        ReadDTCInformation.make_request(reports.reportSupportedDTCs),
        ReadDTCInformation.make_request(reports.reportFirstTestFailedDTC),
        ReadDTCInformation.make_request(reports.reportFirstConfirmedDTC),
        ReadDTCInformation.make_request(reports.reportMostRecentTestFailedDTC),
        ReadDTCInformation.make_request(reports.reportMostRecentConfirmedDTC),
        udsoncan.services.ReadDataByIdentifier.make_request([0xF190], {"default": "s"}),
    ]
    asked = [request.get_payload() for request in asked]
    assert sorted(data[1] for data in asked[:-1]) == list(range(1, 0x0F))
    asked += [bytes.fromhex(text) for text in ("0100", "010C", "03", "07", "0900", "0902", "0904", "0A")]
    tester = Tester(rig)
    wanted = [tester.ask(request) for request in asked]
    for answer in wanted[:-8]:
        assert udsoncan.Response.from_payload(answer).positive
    toml = '[[ecu]]\nname = "gw"\nrequest = 0x7E0\nresponse = 0x7E8\n'
    made = Car(write(tmp_path, BUS + toml + "read = [{ did = 0xF190, every_ms = 86_400_000 }]\n"), [Server(rig)])
    ecu = made.gateway.asking.ecus[0]
    ecu.client.asks[:] = [Ask(request, NEVER, due_ns=k + 1) for k, request in enumerate(asked)]
    got, take = [], ecu.client.on_answer
    ecu.client.on_answer = lambda answer, t_ns: (got.append(answer), take(answer, t_ns))
    made.now = rig.now
    made.run(4000)
    assert got == wanted
    assert made.state()["answers"] == len(asked)
    assert ecu.client.asks == []
    rig.close()


@pytest.mark.long
def test_wireshark_finds_no_malformed_packet_in_what_is_asked(battery, tmp_path):
    made, last, _ = battery
    drive(made, last)
    frames = [(int(f["t_ns"]), int(f["can_id"]), int(f["flags"]) & 1, payload(f)) for f in made.recording()]
    assert len(frames) > 300
    write_pcap(frames, tmp_path / "ask.pcap")
    fields = [
        "_ws.malformed",
        "iso15765.fragment.error",
        "iso15765.message_type.bad",
        "uds.sid",
        "uds.rdbi.data_identifier",
        "can.id",
    ]
    seen = dissect(tmp_path / "ask.pcap", "uds", [0x7E4, 0x7EC], fields)
    assert not [one for one in seen if any(one[name] for name in fields[:3])]
    read = [one for one in seen if one["uds.rdbi.data_identifier"] and int(one["uds.sid"][0], 16) == 0x22]
    asked = [one for one in read if int(one["can.id"][0], 0) == 0x7E4]
    assert len(asked) == made.state()["requests"]


@pytest.mark.long
def test_random_times_and_losses_are_accounted_for_and_replay_the_same(tmp_path):
    print("seed", SEED)
    rng = random.Random(SEED)

    def answer(request):
        if rng.random() < 0.1:
            return []
        if rng.random() < 0.1:
            return [(rng.random() * 400, b"\x7f" + request[:1] + bytes([rng.choice([0x21, 0x22, 0x78, 0x10])]))]
        return [
            (
                rng.random() * 260,
                cells(3.7, rng.choice([3.7, 2.5])) if request == b"\x22\x21\x01" else b"\x62" + request[1:],
            )
        ]

    file = write(tmp_path, BUS + BATTERY)
    made = Car(file, [Ecu(0x7E4, 0x7EC, answer), Ecu(0x7E0, 0x7E8, answer)])
    made.run(30_000)
    made.gateway.stop(made.now)
    for k in (0, 1):
        assert settled(made.state(k))
    again, events = Gateway(load_config(file), file=file), []
    again.listen(events.append)
    frames = made.recording()
    sizes = np.random.default_rng(SEED).integers(1, 400, len(frames))
    cuts = np.cumsum(sizes)
    replay(again, np.split(frames, cuts[cuts < len(frames)]))
    kinds = ("dtc", "monitor", "diagnosis")
    # A diagnosis is told in the pause of the bus in which it fell due, live before what comes next.
    told, live = (sorted((e for e in each if e["event"] in kinds), key=str) for each in (events, made.events))
    assert told == live
    assert len([e for e in events if e["event"] == "dtc"]) > 2
    assert made.now > 30_000 * MS - 1
