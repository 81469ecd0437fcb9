"""scapy's automotive layers as a tester: requests in its own ISO-TP frames, our answers put together and read by it.

scapy says of each answer whether it answers the request, and writes it again: what it read is all there is. Where it
and we differ, the clause is named here:

- the extended data (0x19 06) and snapshots (04) have the lengths of our records (ISO 14229-1, 12.3: defined by the
  manufacturer); scapy reads pairs of bytes, and raw bytes;
- monitors 0xE1 and above are left to the manufacturer (SAE J1979, Appendix D); scapy has no name for them, but the
  same records (mode 06, scalings of Appendix E);
- 0x19 03 names no DTC (ISO 14229-1, 12.3.2.1): scapy's request for 03 has one, and a record number, and is
  refused for its length (13);
- the kinds of messages of 0x28 are the lowest bits of their byte, the subnets the highest four (ISO 14229-1, Annex
  B.1); scapy's communicationType0 is the highest two bits: its communicationType2 is where the kinds are;
- a response on event (0x86) answers with the event's type of the request (10.9.3); scapy has no more than its bytes.
"""

import pytest
from rig import FUNCTIONAL, Rig, write_config
from scapy.config import conf
from test_authentication import a_tester, certificates, signed
from uds_tester import DIDS, hexed

conf.contribs["ISOTP"] = {"use-can-isotp-kernel-module": False}  # read when the layers are loaded

from scapy.contrib.automotive.obd.mid.mids import OBD_MIDXX  # noqa: E402
from scapy.contrib.automotive.obd.obd import OBD, OBD_S01, OBD_S02, OBD_S06, OBD_S09, OBD_S02_Record  # noqa: E402
from scapy.contrib.automotive.uds import (  # noqa: E402
    DTC,
    UDS,
    UDS_AUTH,
    UDS_CC,
    UDS_CDTCI,
    UDS_CDTCS,
    UDS_DSC,
    UDS_ER,
    UDS_RC,
    UDS_RDBI,
    UDS_RDTCI,
    UDS_ROE,
    UDS_SA,
    UDS_TP,
    UDS_WDBI,
)  # fmt: skip
from scapy.contrib.isotp import ISOTP, ISOTP_FC, ISOTPHeader, ISOTPMessageBuilder  # noqa: E402
from scapy.layers.can import CAN  # noqa: E402
from scapy.packet import Raw  # noqa: E402

from gateway.servers.uds.security import hmac_sha256  # noqa: E402

REQUEST, RESPONSE = 0x7E0, 0x7E8
SECRET = "00112233"
#: Status bit: failed since the clear.
FAILED = 0x20
VIN = "1HGCM82633A004352"
SERVERS = f"""
[output.uds]
security = [{{ level = 1, secret = "{SECRET}" }}]
authentication = {{ roots = ["root.pem"], roles = ["workshop"] }}
[access]
clear = {{ sessions = ["extended"] }}
[usage]
denominator = [{{ signal = "M0.Value", min = 400.0 }}]
[output.obd]
vin = "{VIN}"
calibration = "GW-1"
calibration_check = 0x1234ABCD
ecu_name = "GATEWAY"
pid = [{{ id = 0x0C, signal = "M0.Value" }}, {{ id = 0x05, signal = "M1.Value" }}, {{ id = 0x0D, signal = "M2.Value" }}]
"""
FAULT = 'emission_related = true\nindicator = true\nfreeze_frame = ["M0.Value"]\nseverity = "immediately"\n'


class Scapy:
    """A tester whose ISO-TP is scapy's, on the rig's bus and clock."""

    def __init__(self, rig):
        self.rig = rig

    def frames(self, request, functional=False):
        """Send a request; returns the frames that answer it, the flow control among them."""
        rows = ISOTP(bytes(request), rx_id=FUNCTIONAL if functional else REQUEST).fragment()
        heard = []
        for row in rows:
            heard += self.rig.feed((int(row.identifier), bytes(row.data).ljust(8, b"\x55")))
        if any(can_id == RESPONSE and data[0] >> 4 == 1 for can_id, data in heard):
            control = ISOTPHeader(identifier=REQUEST) / ISOTP_FC(fc_flag=0, block_size=0, separation_time=0)
            heard += self.rig.feed((REQUEST, bytes(control)[8:].ljust(8, b"\x55")))
        heard += self.rig.wait(5)
        return [CAN(identifier=can_id, length=len(data), data=data) for can_id, data in heard if can_id == RESPONSE]

    def exchange(self, request, functional=False):
        """Send a request; returns the messages that scapy puts together from what is heard."""
        builder = ISOTPMessageBuilder(use_ext_address=False, rx_id=[RESPONSE])
        builder.feed(self.frames(request, functional))
        return [bytes(message.data) for message in builder]

    def ask(self, request, functional=False):
        """Send a request; returns the one answer, as scapy reads it."""
        (raw,) = self.exchange(request, functional)
        answer = type(request)(raw)
        assert bytes(answer) == raw, "what was read is all there is"
        assert answer.answers(request), answer.summary()
        return answer


@pytest.fixture
def rig(tmp_path):
    certificates(tmp_path)
    made = Rig(write_config(tmp_path, 6, extra=SERVERS + DIDS, faults=dict.fromkeys(range(6), FAULT)))
    made.value(0, 812.5)
    made.value(1, 90)
    made.value(2, 50)
    yield made
    made.close()


@pytest.fixture
def scapy(rig):
    return Scapy(rig)


def dtc(k):
    return DTC(bytes.fromhex(hexed(k)))


@pytest.mark.evidence("ISO 14229-1: others scapy")
def test_dtcs_are_read(rig, scapy):
    for k in range(3):
        rig.fail(k)
    rig.heal(1)
    status = {bytes.fromhex(hexed(k)): rig.status(k) for k in range(6)}
    assert status[bytes.fromhex(hexed(1))] != status[bytes.fromhex(hexed(0))]
    stored = {bytes.fromhex(hexed(k)) for k in range(3)}
    for kind in (0x01, 0x07):
        answer = scapy.ask(UDS() / UDS_RDTCI(reportType=kind, DTCStatusMask=FAILED, DTCSeverityMask=0xFF))
        assert (answer.DTCStatusAvailabilityMask, answer.DTCFormatIdentifier, answer.DTCCount) == (0xFF, 0, 3)
    for kind, expected in ((0x02, stored), (0x0A, set(status)), (0x15, stored)):
        answer = scapy.ask(UDS() / UDS_RDTCI(reportType=kind, DTCStatusMask=FAILED))
        found = {bytes(record.dtc): int(record.status) for record in answer.DTCAndStatusRecord}
        assert found == {code: status[code] for code in expected}
    for kind, k in ((0x0B, 0), (0x0C, 0), (0x0D, 2), (0x0E, 2)):
        (record,) = scapy.ask(UDS() / UDS_RDTCI(reportType=kind)).DTCAndStatusRecord
        assert record.dtc == dtc(k)
    answer = scapy.ask(UDS() / UDS_RDTCI(reportType=0x09, dtc=dtc(0)))
    assert answer.DTCSeverity == 0x81
    assert answer.DTCAndStatusRecord[0].dtc == dtc(0)
    assert scapy.ask(UDS() / UDS_RDTCI(reportType=0x03)).negativeResponseCode == 0x13
    (raw,) = scapy.exchange(b"\x19\x03")
    assert len(UDS(raw).dataRecord) == 3 * 4
    rig.feed((256 + 3, b"\x01"))  # half the way to a failure
    for kind, length in ((0x14, 4), (0x08, 1 + 3 * 6)):
        answer = scapy.ask(UDS() / UDS_RDTCI(reportType=kind, DTCStatusMask=FAILED, DTCSeverityMask=0xFF))
        assert len(answer.dataRecord) == length


def test_snapshots_and_extended_data_belong_to_the_dtc_asked_for(rig, scapy):
    rig.fail(2)
    answer = scapy.ask(UDS() / UDS_RDTCI(reportType=0x04, dtc=dtc(2), DTCSnapshotRecordNumber=1))
    snapshot = answer.snapshotRecord
    assert snapshot.dtcAndStatus.status == rig.status(2)
    assert (snapshot.snapshots[0].record_number, snapshot.snapshots[0].record_number_of_identifiers) == (1, 3), (
        "signals of PIDs too"
    )
    answer = scapy.ask(UDS() / UDS_RDTCI(reportType=0x06, dtc=dtc(2), DTCExtendedDataRecordNumber=1))
    record = answer.extendedDataRecord
    assert record.dtcAndStatus.status == rig.status(2)
    assert [(each.data_type, each.record) for each in record.extendedData] == [(1, 1)], "one occurrence"


@pytest.mark.evidence("ISO 14229-1: others scapy")
def test_services_that_change_something(rig, scapy):
    assert scapy.ask(UDS() / UDS_TP()).service == 0x7E
    assert scapy.exchange(UDS() / UDS_TP(subFunction=0x80), functional=True) == []
    answer = scapy.ask(UDS() / UDS_DSC(diagnosticSessionType=3))
    assert answer.sessionParameterRecord == bytes.fromhex("003201f4")
    answer = scapy.ask(UDS() / UDS_RDBI(identifiers=[0xF190]))
    assert answer.dataIdentifier == 0xF190
    assert answer[Raw].load == VIN.encode()
    writing = UDS() / UDS_WDBI(dataIdentifier=0x0124) / Raw(b"\x0a\x0b")
    refused = scapy.ask(writing)
    assert (refused.requestServiceId, refused.negativeResponseCode) == (0x2E, 0x33)
    seed = scapy.ask(UDS() / UDS_SA(securityAccessType=1)).securitySeed
    assert len(seed) == 8
    key = hmac_sha256(seed, bytes.fromhex(SECRET), 1)
    assert scapy.ask(UDS() / UDS_SA(securityAccessType=2, securityKey=key)).securityAccessType == 2
    assert scapy.ask(writing).dataIdentifier == 0x0124
    assert scapy.ask(UDS() / UDS_RDBI(identifiers=[0x0124]))[Raw].load == b"\x0a\x0b"
    assert scapy.ask(UDS() / UDS_CC(controlType=1, communicationType2=1)).controlType == 1
    assert scapy.ask(UDS() / UDS_CC(controlType=0, communicationType2=1)).controlType == 0
    assert scapy.ask(UDS() / UDS_CDTCS(DTCSettingType=2)).DTCSettingType == 2
    assert scapy.ask(UDS() / UDS_CDTCS(DTCSettingType=1)).DTCSettingType == 1
    answer = scapy.ask(UDS() / UDS_ROE(eventType=1, eventWindowTime=2, eventTypeRecord=bytes.fromhex("08190208")))
    assert (answer.numberOfIdentifiedEvents, answer.eventWindowTime) == (0, 2)
    assert answer.eventTypeRecord == bytes.fromhex("08190208")
    answer = scapy.ask(UDS() / UDS_RC(routineControlType=1, routineIdentifier=0x0201))
    assert answer.routineIdentifier == 0x0201
    rig.fail(0)
    assert scapy.ask(UDS() / UDS_CDTCI(groupOfDTCHighByte=0xFF, groupOfDTCMiddleByte=0xFF, groupOfDTCLowByte=0xFF))
    assert rig.status(0) == 0x50
    assert scapy.ask(UDS() / UDS_ER(resetType=1)).resetType == 1
    assert scapy.ask(UDS(bytes([0x77]))).negativeResponseCode == 0x11


def test_authentication(scapy):
    assert scapy.ask(UDS() / UDS_DSC(diagnosticSessionType=3))
    assert scapy.ask(UDS() / UDS_AUTH(subFunction=8)).returnValue == 0x02
    key, certificate = a_tester()
    shown = UDS() / UDS_AUTH(subFunction=1, certificateClient=certificate, challengeClient=b"mine")
    answer = scapy.ask(shown)
    assert answer.returnValue == 0x11
    assert len(answer.challengeServer) == 32
    proof = signed(key, answer.challengeServer + b"mine")
    assert scapy.ask(UDS() / UDS_AUTH(subFunction=3, proofOfOwnershipClient=proof)).returnValue == 0x12
    assert scapy.ask(UDS() / UDS_AUTH(subFunction=0)).returnValue == 0x10


@pytest.mark.evidence("ISO 15765-2: others")
def test_frames_are_put_together_as_they_were_taken_apart(rig, scapy):
    for k in range(6):
        rig.fail(k)
    frames = scapy.frames(UDS() / UDS_RDTCI(reportType=0x0A))
    assert len(frames) == 4
    whole = ISOTP.defragment(frames, use_extended_addressing=False)
    ours = bytes(frames[0].data)[2:] + b"".join(bytes(frame.data)[1:] for frame in frames[1:])
    assert whole.data == ours[: 3 + 6 * 4]
    again = ISOTP(whole.data, rx_id=RESPONSE).fragment()
    assert [bytes(row.data).ljust(8, b"\xcc") for row in again] == [bytes(row.data) for row in frames]


@pytest.mark.evidence("SAE J1979: others")
def test_obd_values(rig, scapy):
    answer = scapy.ask(OBD() / OBD_S01(pid=[0x00]), functional=True)
    assert sorted(str(answer.data_records[0].supported_pids).split("+")) == sorted(
        ["PID01", "PID05", "PID0C", "PID0D", "PID1C", "PID20"]
    )
    answer = scapy.ask(OBD() / OBD_S01(pid=[0x0C, 0x05, 0x0D]), functional=True)
    values = [record.payload for record in answer.data_records]
    assert [value.data for value in values] == [812.5, 90, 50]
    rig.fail(0)
    rig.fail(4)
    (record,) = scapy.ask(OBD() / OBD_S01(pid=[0x01])).data_records
    assert (record.mil, record.dtc_count, str(record.continuous_tests_supported)) == (1, 2, "components")


def test_obd_dtcs(rig, scapy):
    rig.fail(0)
    rig.fail(1)
    for mode in (0x03, 0x07, 0x0A):
        answer = scapy.ask(OBD(service=mode), functional=True)
        assert answer.count == 2
        assert [bytes(code).hex() for code in answer.dtcs] == [hexed(k)[:4] for k in (0, 1)]
    answer = scapy.ask(OBD() / OBD_S02(requests=[OBD_S02_Record(pid=0x02), OBD_S02_Record(pid=0x0C)]))
    first, second = answer.data_records
    assert bytes(first.dtc).hex() == hexed(0)[:4]
    assert second.data == 812.5
    assert scapy.ask(OBD(service=0x04), functional=True).service == 0x44
    assert scapy.ask(OBD(service=0x03)).count == 0


def test_obd_test_results_and_information(rig, scapy):
    rig.fail(0)
    answer = scapy.ask(OBD() / OBD_S06(mid=[0xE0]))
    assert answer.data_records[0].mid == 0xE0
    (raw,) = scapy.exchange(OBD() / OBD_S06(mid=[0xE1]))
    assert raw[:2] == b"\x46\xe1"
    result = OBD_MIDXX(raw[2:])
    assert result.standardized_test_id == 0x80
    assert result.test_value == pytest.approx(1.0, abs=1e-3), "a frame of one byte"
    assert result.min_limit == pytest.approx(8.0, abs=1e-3)
    texts = {0x02: VIN.encode(), 0x04: b"GW-1".ljust(16, b"\0"), 0x0A: b"GATEWAY".ljust(20, b"\0")}
    infos = {**texts, 0x06: bytes.fromhex("1234abcd")}
    for number, expected in infos.items():
        (record,) = scapy.ask(OBD() / OBD_S09(iid=[number])).data_records
        (name,) = [field.name for field in record.payload.fields_desc if field.name != "count"]
        assert (record.count, getattr(record, name)) == (1, [expected])
    rig.value(0, 812.5)
    rig.wait(300)
    (record,) = scapy.ask(OBD() / OBD_S09(iid=[0x08])).data_records
    assert record.payload.data == [1, 1, *[0] * 18], "general denominator and ignition cycles"
    refused = scapy.ask(OBD() / OBD_S01(pid=[0x77]))
    assert (refused.request_service_id, refused.response_code) == (0x01, 0x12)
