"""DTCs of an ECU that answers, as its testers read and clear them by UDS (0x19, 0x14) and OBD (03, 04, 07, 0A)."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field

from gateway.faults.dtc import ALL_DTCS, Dtc, in_group
from gateway.faults.settings import DtcText
from gateway.faults.status import NOT_COMPLETED, Status
from gateway_fdi.common.tomlfile import StrictModel

POSITIVE, NEGATIVE = 0x40, 0x7F
SUB_FUNCTION, LENGTH, OUT_OF_RANGE = 0x12, 0x13, 0x31
CLEAR, READ = 0x14, 0x19
#: Reports of 0x19 -> length of a request for it: of all DTCs, of the emission system (group 0x33), of one DTC.
_ALL, _GROUP, _ONE = {0x01: 3, 0x02: 3, 0x0A: 2}, {0x42: 5, 0x55: 3}, {0x04: 6, 0x06: 6}
#: Protocol of OBD -> its reports.
REPORTS = {"obd": _ALL | _ONE, "obd_on_uds": _GROUP | _ONE, "both": _ALL | _GROUP | _ONE}
_EMISSION, _ANY_GROUP, _WWH_FORMAT = 0x33, 0xFF, 0x04
#: Modes of OBD -> bit of the status that shows a DTC in them; None: permanent ones.
_MODES = {0x03: Status.CONFIRMED_DTC, 0x07: Status.PENDING_DTC, 0x0A: None}
_OBD_CLEAR = 0x04
_HEX = r"^([0-9A-Fa-f]{2}\s*)*$"
#: Record number that asks for all.
_ALL_RECORDS = 0xFF
#: All bits that the ECU knows.
AVAILABLE = 0xFF
#: After a clear no test has been completed.
CLEARED = NOT_COMPLETED


class StoredDtc(StrictModel):
    """A DTC in the memory of an ECU that answers."""

    code: DtcText = Field(description='e.g. "P0301-00"')
    status: int = Field(0x2F, ge=0, le=0xFF, description="status byte (ISO 14229-1, Annex D.2)")
    from_s: float = Field(0.0, ge=0, allow_inf_nan=False, description="when it is set [s]")
    permanent: bool = Field(False, description="a clear leaves it in mode 0A")
    severity: int = Field(0x02, ge=0, le=0xFF, description="19 42: severity and class (ISO 14229-1, Annex D.3)")
    snapshot: str = Field("", pattern=_HEX, description="19 04: record 1 in hex, from its count of identifiers on")
    extended: str = Field("", pattern=_HEX, description="19 06: extended data record 1, in hex")

    @property
    def bytes(self) -> bytes:
        """Its three bytes."""
        return bytes(Dtc.parse(self.code))


class DtcMemory:
    """The memory.

    Args:
        stored: what comes into it.
        protocol: of OBD, a key of REPORTS.
    """

    def __init__(self, stored: Sequence[StoredDtc], protocol: str = "obd") -> None:
        self._stored, self._lengths = stored, REPORTS[protocol]
        self._modes = frozenset() if protocol == "obd_on_uds" else frozenset({_OBD_CLEAR, *_MODES})
        self._cleared_ns: dict[int, int] = {}

    @property
    def services(self) -> frozenset[int]:
        """Services that it answers; none where the scenario gives it no DTCs."""
        return frozenset({READ, CLEAR}) | self._modes if self._stored else frozenset()

    def answer(self, request: bytes, t_ns: int) -> bytes:
        """Return the answer to a request for one of its services.

        Args:
            request: without a wish to suppress the answer.
            t_ns: when it came [ns].
        """
        service = request[0]
        if service == CLEAR:
            return self._clear(request, t_ns)
        if service == READ:
            return self._report(request, t_ns)
        if len(request) != 1:
            return bytes([NEGATIVE, service, LENGTH])
        if service == _OBD_CLEAR:
            self._cleared_ns |= dict.fromkeys(range(len(self._stored)), t_ns)
            return bytes([service + POSITIVE])
        bit = _MODES[service]
        found = [one for one, status in self._now(t_ns) if (status & bit if bit else one.permanent)]
        return bytes([service + POSITIVE, len(found)]) + b"".join(one.bytes[:2] for one in found)

    def _now(self, t_ns: int) -> list[tuple[StoredDtc, int]]:
        """Return what is stored, with the status now."""
        found = []
        for k, one in enumerate(self._stored):
            cleared = self._cleared_ns.get(k, -1)
            if one.from_s * 1e9 <= t_ns:
                found.append((one, one.status if one.from_s * 1e9 > cleared else int(CLEARED)))
        return found

    def _clear(self, request: bytes, t_ns: int) -> bytes:
        if len(request) != 4:
            return bytes([NEGATIVE, CLEAR, LENGTH])
        group = int.from_bytes(request[1:], "big")
        mine = [
            k
            for k, one in enumerate(self._stored)
            if in_group(Dtc.parse(one.code).value, group, emission_related=Dtc.parse(one.code).is_powertrain)
        ]
        if not mine and group != ALL_DTCS:
            return bytes([NEGATIVE, CLEAR, OUT_OF_RANGE])
        self._cleared_ns |= dict.fromkeys(mine, t_ns)
        return bytes([CLEAR + POSITIVE])

    def _report(self, request: bytes, t_ns: int) -> bytes:
        if len(request) < 2 or request[1] not in self._lengths:
            return bytes([NEGATIVE, READ, SUB_FUNCTION if len(request) > 1 else LENGTH])
        report = request[1]
        if len(request) != self._lengths[report]:
            return bytes([NEGATIVE, READ, LENGTH])
        now = self._now(t_ns)
        head = bytes([READ + POSITIVE, report])
        if report in (0x04, 0x06):
            return self._record(head, request, now)
        if report in _GROUP:
            return self._of_group(head, request, now)
        mask = AVAILABLE if report == 0x0A else request[2]
        found = [one.bytes + bytes([status]) for one, status in now if report == 0x0A or status & mask]
        if report == 0x01:
            return head + bytes([AVAILABLE, 0x00]) + len(found).to_bytes(2, "big")
        return head + bytes([AVAILABLE]) + b"".join(found)

    def _of_group(self, head: bytes, request: bytes, now: Sequence[tuple[StoredDtc, int]]) -> bytes:
        """Return the DTCs of the emission system: by masks of status and severity, or permanent ones."""
        group, *masks = request[2:]
        if group not in (_EMISSION, _ANY_GROUP):
            return bytes([NEGATIVE, READ, OUT_OF_RANGE])
        mine = [(one, s) for one, s in now if group == _ANY_GROUP or Dtc.parse(one.code).is_powertrain]
        if not masks:
            rows = (one.bytes + bytes([status]) for one, status in mine if one.permanent)
            return head + bytes([group, AVAILABLE, _WWH_FORMAT]) + b"".join(rows)
        found = [(one, s) for one, s in mine if s & masks[0] and one.severity & masks[1]]
        rows = (bytes([one.severity]) + one.bytes + bytes([status]) for one, status in found)
        return head + bytes([group, AVAILABLE, 0xFF, _WWH_FORMAT]) + b"".join(rows)

    def _record(self, head: bytes, request: bytes, now: Sequence[tuple[StoredDtc, int]]) -> bytes:
        """Return a snapshot or extended data record of one DTC; after a clear it has none."""
        record = request[5]
        for one, status in now:
            if one.bytes != request[2:5]:
                continue
            text = one.snapshot if head[1] == 0x04 else one.extended
            has = bool(text.strip()) and status == one.status
            if record not in (0x01, _ALL_RECORDS):
                break
            data = b"\x01" + bytes.fromhex(text) if has else b""
            return head + one.bytes + bytes([status]) + data
        return bytes([NEGATIVE, READ, OUT_OF_RANGE])
