"""Answers that tell DTCs: UDS 0x19, OBD modes 03, 07 and 0A."""

from __future__ import annotations

from gateway.faults.dtc import Dtc
from gateway.faults.vehicle import PERMANENT, SEVERITY, TOLD, DtcAnswer
from gateway_ask.answers.answer_frames import POSITIVE

READ_DTCS = 0x19
BY_MASK, SNAPSHOTS, EXTENDED_DATA, PERMANENTS = 0x02, 0x04, 0x06, 0x15
#: Of one functional group (ISO 14229-1:2020): by masks of status and severity, permanent, by readiness group.
OF_GROUP, PERMANENTS_OF_GROUP, BY_READINESS = 0x42, 0x55, 0x56
#: Bits of a status: pending, and those that none has without it; confirmed, and the lamp, which none has without it.
_PENDING, _FAILED, _CONFIRMED, _LAMP = 0x04, 0x03, 0x08, 0x80
#: OBD mode -> bit of the status that it stands for.
_OBD = {0x03: 0x08, 0x07: 0x04, 0x0A: PERMANENT}
#: Reports of 0x19 that are lists of DTCs (three bytes, and the status) -> bytes in front of them.
_LISTS = {
    **dict.fromkeys((BY_MASK, 0x0A, 0x0B, 0x0C, 0x0D, 0x0E, PERMANENTS), 3),
    PERMANENTS_OF_GROUP: 5,
    OF_GROUP: 6,
    BY_READINESS: 6,
}


def read_dtcs(ecu: str, answer: bytes, request: bytes) -> DtcAnswer | None:
    """Return what an answer says of DTCs; None: nothing.

    Args:
        ecu: name of the ECU.
        answer: from the service on, not empty.
        request: that came before it; b"": it was not heard.
    """
    service = answer[0] - POSITIVE
    if service in _OBD and len(answer) >= 2:
        return _of_obd(ecu, service, answer)
    if service != READ_DTCS or len(answer) < 3:
        return None
    report = answer[1]
    if report in _LISTS:
        return _of_list(ecu, report, answer, request)
    if report in (SNAPSHOTS, EXTENDED_DATA) and len(answer) > 6:
        dtc = str(Dtc.from_bytes(answer[2:5]))
        return DtcAnswer(ecu, {dtc: answer[5]}, 0, kind=f"19{report:02X}", data={dtc: answer[6:].hex().upper()})
    return None


def _of_list(ecu: str, report: int, answer: bytes, request: bytes) -> DtcAnswer | None:
    """Return what a list of DTCs says; None: it is no whole one."""
    head, at = _LISTS[report], int(report == OF_GROUP)  # behind a byte of severity and class
    if len(answer) < head:
        return None
    rows = [answer[k : k + at + 4] for k in range(head, len(answer) - at - 3, at + 4)]
    named = {str(Dtc.from_bytes(row[at : at + 3])): row for row in rows}
    named.pop("P0000-00", None)  # none, as some ECUs write it
    found = {dtc: row[-1] for dtc, row in named.items()}
    if report in (PERMANENTS, PERMANENTS_OF_GROUP):
        return DtcAnswer(ecu, dict.fromkeys(found, PERMANENT), PERMANENT, whole=False, kind=f"19{report:02X}")
    known = request[:2] == bytes([READ_DTCS, report])
    if report != OF_GROUP:
        return DtcAnswer(ecu, found, request[2] if known and report == BY_MASK and len(request) == 3 else 0)
    data = {dtc: row[:1].hex().upper() for dtc, row in named.items()}
    if not known or len(request) != 5 or request[2] != answer[2]:
        return DtcAnswer(ecu, found, 0, kind=SEVERITY, data=data)
    covers, severity = request[3], request[4]
    if covers & TOLD == TOLD & 0xFF:
        return DtcAnswer(ecu, found, covers, kind=SEVERITY, data=data, severity=severity)
    covers |= (covers & _PENDING and _FAILED) | (covers & _CONFIRMED and _LAMP)
    found = {dtc: status & covers for dtc, status in found.items()}
    return DtcAnswer(ecu, found, covers, whole=False, kind=SEVERITY, data=data, severity=severity)


def _of_obd(ecu: str, mode: int, answer: bytes) -> DtcAnswer | None:
    codes = [answer[k : k + 2] for k in range(2, len(answer) - 1, 2)]
    found = {str(Dtc(int.from_bytes(code, "big") << 8))[:5]: _OBD[mode] for code in codes if any(code)}
    whole = len(codes) >= answer[1]  # else the answer is cut, and others may be there
    return DtcAnswer(ecu, found, _OBD[mode] if whole else 0, whole=False)


def details_of(dtc: str) -> tuple[bytes, bytes]:
    """Return the requests for all snapshots and all extended data of a DTC."""
    code = bytes(Dtc.parse(dtc))
    return bytes([READ_DTCS, SNAPSHOTS]) + code + b"\xff", bytes([READ_DTCS, EXTENDED_DATA]) + code + b"\xff"
