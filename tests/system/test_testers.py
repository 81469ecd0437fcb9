"""Third-party testers against the daemon, on the loopback bus: udsoncan, gallia, can-j1939."""

import json
import re
import struct
import subprocess
import time
from contextlib import ExitStack

import can
import cantools
import j1939
import pytest
import udsoncan
from processes import bus, gateway, process
from rig import dtc_text, write_config
from testers import (
    FUNCTIONAL,
    gallia_command,
    isotp_stack,
    lines_bridge,
    open_can,
    quiet_environment,
)
from uds_tester import DIDS
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection
from udsoncan.services import RoutineControl
from udsoncan_settings import PATIENT

from gateway.faults.dtc import Dtc
from gateway_fdi.common.resources import shipped

pytestmark = pytest.mark.system

COUNT = 60
#: Of the gateway itself: memory not written or damaged, died again and again, monitoring off.
OWN = [Dtc.parse(code).value for code in ("U3000-42", "U3000-44", "U3000-47", "U3000-53", "U3000-81")]
SERVERS = """
[output.dtc_frame]
cycle_ms = 300.0

[output.uds]
security = [{ level = 1, secret = "00112233" }]
write = { sessions = ["extended"], security = 1 }
clear = {}

[output.obd]
vin = "1HGCM82633A004352"
pid = [{ id = 0x0C, signal = "M0.Value" }]

[output.j1939]
address = 0x10
"""
FAULTS = {
    k: f'spn = {100 + k}\nfmi = 3\nseverity = "immediately"\nfreeze_frame = ["volts", "M1.Value"]\n'
    "indicator = true\nemission_related = true\n"
    for k in range(COUNT)
}
SETTINGS = {
    "data_identifiers": {
        0xF190: udsoncan.AsciiCodec(17),
        0x0123: ">H",
        0x0124: ">BB",
        0x4000: ">f",
        0x4001: ">f",
        "default": ">f",
    },
    "extended_data_size": 1,
    "security_algo": None,
}


class Bench:
    """The daemon with sixty faults, and an ECU that can make each of them come and go."""

    def __init__(self, folder, uri):
        self.folder, self.uri = folder, uri
        self.ecu = open_can(uri)

    def send(self, k, data):
        self.ecu.send(can.Message(arbitration_id=256 + k, data=data, is_extended_id=False))

    def fail(self, *faults):
        for k in faults:
            self.send(k, b"\x01")
            self.send(k, b"\x01")

    def heal(self, *faults):
        for k in faults:
            for _ in range(53):
                self.send(k, bytes(8))

    def listed(self):
        made = gateway("faults", "list", "--memory", "f.sqlite", "--json", cwd=self.folder)
        return json.loads(made.stdout)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("testers")
    config = write_config(folder, COUNT, extra=SERVERS + DIDS, faults=FAULTS)
    with ExitStack() as stack:
        uri = stack.enter_context(bus(folder))
        daemon = stack.enter_context(
            process("run", config, "--bus", uri, "--json", "--memory", "f.sqlite",
                    cwd=folder, ready="monitoring")
        )  # fmt: skip
        made = Bench(folder, uri)
        yield made
        made.ecu.shutdown()
    assert daemon.code == 0


@pytest.fixture
def client(bench):
    with isotp_stack(bench.uri, start=False) as stack:
        connection = PythonIsoTpConnection(stack)
        with Client(connection, config={**PATIENT, **SETTINGS}) as made:
            made.clear_dtc()
            yield made


def numbers(answer):
    return [dtc.id for dtc in answer.service_data.dtcs]


def code(k):
    return Dtc.parse(dtc_text(k)).value


@pytest.mark.evidence("ISO 14229-1: 0x19 others")
def test_udsoncan_reads_every_sub_function_with_more_than_fifty_dtcs(bench, client):
    bench.send(0, struct.pack("<H", 25) + bytes(6))
    bench.fail(*range(COUNT))
    limit = time.monotonic() + 120
    while len(numbers(client.get_dtc_by_status_mask(0x08))) < COUNT and time.monotonic() < limit:
        time.sleep(0.05)
    everything = sorted(code(k) for k in range(COUNT))

    found = client.get_dtc_by_status_mask(0x08)
    assert numbers(found) == everything
    assert {dtc.status.get_byte_as_int() for dtc in found.service_data.dtcs} == {0xAF}
    found = client.get_dtc_by_status_mask(0xFF)
    untested = {dtc.id: dtc.status.get_byte_as_int() for dtc in found.service_data.dtcs}
    assert {dtc: untested.pop(dtc) for dtc in everything} == dict.fromkeys(everything, 0xAF)
    assert untested == dict.fromkeys(OWN, 0x50), "not tested since the memory was cleared"
    assert client.get_number_of_dtc_by_status_mask(0x08).service_data.dtc_count == COUNT
    assert numbers(client.get_supported_dtc()) == sorted([*everything, *OWN])
    assert numbers(client.get_first_test_failed_dtc()) == [code(0)]
    assert numbers(client.get_first_confirmed_dtc()) == [code(0)]
    assert numbers(client.get_most_recent_test_failed_dtc()) == [code(COUNT - 1)]
    assert numbers(client.get_most_recent_confirmed_dtc()) == [code(COUNT - 1)]
    assert numbers(client.get_dtc_with_permanent_status()) == everything

    snapshots = client.get_dtc_snapshot_identification()
    assert {dtc.id: dtc.snapshots for dtc in snapshots.service_data.dtcs} == {dtc: [1] for dtc in everything}
    (dtc,) = client.get_dtc_snapshot_by_dtc_number(code(0), 0xFF).service_data.dtcs
    first = dtc.snapshots[0]
    assert (first.record_number, first.did, first.data) == (1, 0x0123, (50,))
    (dtc,) = client.get_dtc_extended_data_by_dtc_number(code(0), 1).service_data.dtcs
    assert [(e.record_number, e.raw_data) for e in dtc.extended_data] == [(1, b"\x01")]
    (dtc,) = client.get_dtc_extended_data_by_dtc_number(code(0), 0x10, data_size=8).service_data.dtcs
    assert struct.unpack(">q", dtc.extended_data[0].raw_data)[0] > 10**18

    assert client.get_number_of_dtc_by_status_severity_mask(0x80, 0x80).service_data.dtc_count == COUNT
    by_severity = client.get_dtc_by_status_severity_mask(status_mask=0x80, severity_mask=0x80)
    assert numbers(by_severity) == everything
    (dtc,) = client.get_dtc_severity(code(3)).service_data.dtcs
    assert dtc.severity.check_immediately
    assert dtc.status.confirmed

    wwh = client.get_wwh_obd_dtc_by_status_mask(
        functional_group_id=0x33, status_mask=0x08, severity_mask=0xE0, dtc_class=0
    )
    assert numbers(wwh) == everything
    # 0x55 has no severity in its records (ISO 14229-1, table of its response; py-uds agrees), udsoncan reads one:
    # it can take an answer only if its length fits, and then not apart.
    permanent = client.get_wwh_obd_dtc_with_permanent_status(0x33)
    assert permanent.service_data.functional_group_id == 0x33
    assert len(permanent.data) == 4 + 4 * COUNT

    bench.heal(2)
    bench.send(2, b"\x01")
    limit = time.monotonic() + 120
    counters = []
    while not counters and time.monotonic() < limit:
        counters = client.get_dtc_fault_counter().service_data.dtcs
    assert [(dtc.id, dtc.fault_counter) for dtc in counters] == [(code(2), 63)]

    client.clear_dtc(code(5))
    assert code(5) not in numbers(client.get_dtc_by_status_mask(0x08))
    assert len(numbers(client.get_dtc_by_status_mask(0x08))) == COUNT - 1
    client.clear_dtc()
    assert numbers(client.get_dtc_by_status_mask(0x2F)) == []
    assert len(numbers(client.get_dtc_with_permanent_status())) == COUNT


def test_udsoncan_uses_every_other_service(client):
    from gateway.servers.uds.security import hmac_sha256

    client.config["security_algo"] = lambda level, seed, params: hmac_sha256(
        seed, bytes.fromhex("00112233"), (level + 1) // 2
    )
    assert client.read_data_by_identifier_first(0xF190) == "1HGCM82633A004352"
    session = client.change_session(3)
    assert session.service_data.p2_server_max == 0.05
    assert session.service_data.p2_star_server_max == 5.0
    client.unlock_security_access(1)
    client.write_data_by_identifier(0x0124, (3, 4))
    assert client.read_data_by_identifier_first(0x0124) == (3, 4)
    client.control_dtc_setting(2)
    client.control_dtc_setting(1)
    client.communication_control(control_type=1, communication_type=udsoncan.CommunicationType(0, normal_msg=True))
    client.communication_control(control_type=0, communication_type=udsoncan.CommunicationType(0, normal_msg=True))
    client.tester_present()
    client.set_config("p2_timeout", 1)  # the client waits it out where no answer comes
    with client.suppress_positive_response(wait_nrc=True):
        client.tester_present()
    client.set_config("p2_timeout", 60)
    done = client.routine_control(0x0202, RoutineControl.ControlType.startRoutine)
    assert done.service_data.routine_status_record == b"\x00", "through 0x78"
    client.ecu_reset(1)
    with pytest.raises(udsoncan.exceptions.NegativeResponseException) as refused:
        client.read_data_by_identifier([0xBEEF])
    assert refused.value.response.code == 0x31


def scan(target, folder, *arguments):
    """Run a scan; returns what it reports as results, and what it complains of."""
    made = subprocess.run(
        [*gallia_command(), "scan", "uds", *arguments, "--no-dumpcap", "--target", target],
        env=quiet_environment(folder), capture_output=True, text=True, timeout=1000, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr[-3000:]
    text = re.sub(r"\x1b\[[0-9;]*m", "", made.stderr + made.stdout)
    results = [line.partition("[result]: ")[2] for line in text.splitlines() if "[result]" in line]
    complaints = [
        line
        for line in text.splitlines()
        if re.search(r"\[(warning|error|critical)\]|malformed|illegal|[Uu]nexpected|timeout", line)
    ]
    return results, complaints


@pytest.fixture
def scanner(bench, tmp_path):
    with isotp_stack(bench.uri) as stack, lines_bridge(stack, tmp_path / "s") as target:
        yield lambda *arguments: scan(target, tmp_path, *arguments)


@pytest.mark.evidence("ISO 14229-1: others gallia")
def test_gallia_finds_exactly_our_services_and_sessions(scanner):
    results, complaints = scanner("services", "--sessions", "1", "3")
    assert complaints == []
    session, found = None, {}
    for line in results:
        if match := re.search(r"findings in session 0x(\w\w)", line):
            session = int(match[1], 16)
        elif match := re.search(r"\[0x(\w\w)\]", line):
            found.setdefault(session, []).append(int(match[1], 16))
    obd = [0x01, 0x02, 0x03, 0x04, 0x06, 0x07, 0x09, 0x0A]
    default = [*obd, 0x10, 0x14, 0x19, 0x22, 0x3E, 0x86]
    assert found == {1: default, 3: sorted([*default, 0x11, 0x27, 0x28, 0x2E, 0x31, 0x85])}
    results, complaints = scanner("sessions", "--depth", "1")
    assert complaints == []
    assert re.findall(r"\* Session 0x(\w\w)", "\n".join(results)) == ["01", "03"]


@pytest.mark.evidence("ISO 14229-1: others gallia")
def test_gallia_finds_exactly_our_identifiers(scanner, bench):
    """The ranges that ours lie in; a scan of all 65536 in both sessions takes three minutes."""
    found = set()
    for first, last in ((0x0000, 0x01FF), (0x3F80, 0x407F), (0xF100, 0xF1FF), (0xFD00, 0xFD1F)):
        results, complaints = scanner("identifiers", "--sessions", "1", "--start", str(first), "--end", str(last))
        assert complaints == []
        text = "\n".join(results)
        found |= {int(number, 16) for number in re.findall(r"0x([0-9a-f]{4}): ReadDataByIdentifierResponse", text)}
        assert "Abnormal replies: 0" in text
        assert "Timeouts: 0" in text
    exported = gateway("faults", "export", "rig.toml", cwd=bench.folder)
    ours = {int(entry["id"], 16) for entry in json.loads(exported.stdout)["identifiers"]}
    assert found == ours | {0xF186}


@pytest.mark.evidence("SAE J1939-73: others")
def test_can_j1939_receives_our_dm1(bench, client):
    heard = []
    ecu = j1939.ElectronicControlUnit(send_message=lambda *_: None)  # it only listens
    tool = ecu.add_ca(name=j1939.Name(identity_number=7), device_address=0xF9)
    dm1 = j1939.Dm1(tool)
    dm1.subscribe(lambda source, lamps, dtcs, t: heard.append((source, lamps["mil"], dtcs)))
    wanted = [{"spn": 100 + k, "fmi": 3, "oc": 1} for k in (7, 8, 9)]
    with open_can(bench.uri) as listener:
        bench.fail(7, 8, 9)
        limit = time.monotonic() + 120
        while time.monotonic() < limit and not (heard and heard[-1][2] == wanted):
            frame = listener.recv(0.2)
            if frame is not None and frame.is_extended_id:
                ecu.notify(frame.arbitration_id, frame.data, frame.timestamp)
    ecu.stop()
    assert heard[-1][0] == 0x10
    assert heard[-1][1] == j1939.DtcLamp.ON
    assert heard[-1][2] == wanted


def test_all_outputs_show_the_same_memory(bench, client):
    """One state of the memory, seen by UDS, OBD, J1939, the DTC frame and the command line."""
    listener = open_can(bench.uri)
    failing, healed = {11, 14, 17}, {20, 21}
    bench.fail(*failing, *healed)
    bench.heal(*healed)
    limit = time.monotonic() + 120
    expected = {code(k): 0xAF for k in failing} | {code(k): 0xAE for k in healed}

    def by_uds():
        dtcs = client.get_dtc_by_status_mask(0x08).service_data.dtcs
        return {dtc.id: dtc.status.get_byte_as_int() for dtc in dtcs}

    while by_uds() != expected and time.monotonic() < limit:
        time.sleep(0.05)
    assert by_uds() == expected

    listed = bench.listed()
    assert {Dtc.parse(entry["dtc"]).value: entry["status"] for entry in listed} == expected

    with isotp_stack(bench.uri) as stack:
        with open_can(bench.uri) as sender:
            sender.send(can.Message(arbitration_id=FUNCTIONAL, data=b"\x01\x03", is_extended_id=False))
        answer = stack.recv(block=True, timeout=60)
    assert answer[:2] == bytes([0x43, len(expected)])
    by_obd = {bytes(answer[k : k + 2]) for k in range(2, len(answer), 2)}
    assert by_obd == {number.to_bytes(3, "big")[:2] for number in expected}

    message = cantools.database.load_file(shipped("dbc/gateway.dbc")).get_message_by_name("GW_DTC")
    by_frame, packets, active = {}, [], None
    limit = time.monotonic() + 120
    while (by_frame != expected or active is None) and time.monotonic() < limit:
        frame = listener.recv(0.2)
        if frame is None:
            continue
        if not frame.is_extended_id and frame.arbitration_id == message.frame_id:
            values = message.decode(bytes(frame.data))
            if values["Index"]:
                by_frame[values["Dtc"]] = values["Status"]
                by_frame = {k: v for k, v in by_frame.items() if k in expected}
        elif frame.is_extended_id and frame.arbitration_id & 0xFF == 0x10:
            page = frame.arbitration_id >> 16 & 0xFF
            if page == 0xEC and frame.data[0] == 32:
                packets = []
            elif page == 0xEB:
                packets.append(bytes(frame.data[1:]))
                data = b"".join(packets)[: 2 + 4 * len(failing)]
                spns = {data[k] | data[k + 1] << 8 for k in range(2, len(data) - 3, 4)}
                if spns == {100 + k for k in failing}:
                    active = data
    assert by_frame == expected
    assert active is not None
    assert active[0] & 0xC0 == 0x40, "and the lamp is on in all of them"
    listener.shutdown()
