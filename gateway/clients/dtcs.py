"""Answers that tell DTCs: UDS 0x19, OBD modes 03, 07 and 0A."""

from __future__ import annotations

from gateway.answers.weave import POSITIVE
from gateway.faults.dtc import Dtc
from gateway.faults.vehicle import PERMANENT, Told

READ_DTCS = 0x19
BY_MASK, SNAPSHOTS, EXTENDED_DATA = 0x02, 0x04, 0x06
#: OBD mode -> bit of the status that it stands for.
_OBD = {0x03: 0x08, 0x07: 0x04, 0x0A: PERMANENT}
#: Reports of 0x19 that are lists of a DTC (three bytes) and its status, behind a status availability mask.
_LISTS = (BY_MASK, 0x0A, 0x0B, 0x0C, 0x0D, 0x0E, 0x15)


def told_by(ecu: str, answer: bytes, request: bytes) -> Told | None:
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
        found = {str(Dtc.from_bytes(answer[k : k + 3])): answer[k + 3] for k in range(3, len(answer) - 3, 4)}
        found.pop("P0000-00", None)  # none, as some ECUs write it
        known = report == BY_MASK and request[:2] == bytes([READ_DTCS, BY_MASK]) and len(request) == 3
        return Told(ecu, found, request[2] if known else 0)
    if report in (SNAPSHOTS, EXTENDED_DATA) and len(answer) > 6:
        dtc = str(Dtc.from_bytes(answer[2:5]))
        return Told(ecu, {dtc: answer[5]}, 0, kind=f"19{report:02X}", snapshot=answer[6:].hex().upper())
    return None


def _of_obd(ecu: str, mode: int, answer: bytes) -> Told | None:
    codes = [answer[k : k + 2] for k in range(2, len(answer) - 1, 2)]
    found = {str(Dtc(int.from_bytes(code, "big") << 8))[:5]: _OBD[mode] for code in codes if any(code)}
    whole = len(codes) >= answer[1]  # else the answer is cut, and others may be there
    return Told(ecu, found, _OBD[mode] if whole else 0, whole=False)


def details_of(dtc: str) -> tuple[bytes, bytes]:
    """Return the requests for all snapshots and all extended data of a DTC."""
    code = bytes(Dtc.parse(dtc))
    return bytes([READ_DTCS, SNAPSHOTS]) + code + b"\xff", bytes([READ_DTCS, EXTENDED_DATA]) + code + b"\xff"
