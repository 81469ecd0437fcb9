"""The OBD server: one handler a mode (J1979 calls them services).

A functional request for something that is not there is not answered at all; a physical one is refused, as by the
UDS server that shares the address.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from gateway.faults.dtc import EMISSION_DTCS
from gateway.faults.entries import Entry
from gateway.faults.interventions import DONE, Intervention
from gateway.faults.memory import FaultMemory
from gateway.faults.records import FreezeFrame
from gateway.faults.status import Status
from gateway.faults.store import StoreError
from gateway.servers.application import Application
from gateway.servers.authority import SESSIONLESS_ASKER, Authority
from gateway.servers.tester_control import TesterControl
from gateway_testers.obd.params import ObdParams
from gateway_testers.obd.test_results import MonitorTests
from gateway_testers.obd.usage import TRACKED, driven_pids, tracking
from gateway_testers.readiness import readiness

#: Negative responses to physical requests.
_NOT_SUPPORTED, _NO_SUCH_PARAMETER, _CONDITIONS_NOT_CORRECT = 0x11, 0x12, 0x22
#: The answer comes later (P2* of ISO 15765-4).
_RESPONSE_PENDING = 0x78
#: PIDs that one request may ask for (ISO 15031-5, on CAN).
MOST_PIDS = 6


def _bitmap(base: int, numbers: Iterable[int]) -> bytes:
    """Return which of the 32 numbers after ``base`` there are; the last bit: whether there are any beyond."""
    bits = 0
    for number in numbers:
        if base < number <= base + 0x1F:
            bits |= 1 << (base + 0x20 - number)
        elif number > base + 0x1F:
            bits |= 1
    return bits.to_bytes(4, "big")


class _RefusedError(Exception):
    """Clearing is not allowed, or not now."""


class ObdServer(Application):
    """Answers the modes of J1979.

    Args:
        params: settings.
        memory: the fault memory.
        control: the gateway.
        authority: says whether mode 04 may clear.
        bus: name of its bus.
    """

    #: Modes of J1979: identifiers below those of UDS.
    services = range(0x01, 0x0B)

    def __init__(
        self,
        params: ObdParams,
        memory: FaultMemory,
        control: TesterControl,
        authority: Authority,
        bus: str = "",
    ) -> None:
        self._params = params
        self._memory = memory
        self._control = control
        self._authority = authority
        self._bus = bus
        self._tests = MonitorTests(memory.catalogue, control)
        self._pids = {pid.id: pid for pid in params.pid}
        self._modes: dict[int, Callable[[bytes], bytes]] = {
            0x01: self._x01_current_data,
            0x02: self._x02_freeze_frame,
            0x03: lambda rest: self._dtcs(rest, Status.CONFIRMED_DTC),
            0x04: self._x04_clear,
            0x06: self._x06_test_results,
            0x07: lambda rest: self._dtcs(rest, Status.PENDING_DTC),
            0x09: self._x09_vehicle_information,
            0x0A: self._x0a_permanent,
        }

    def answer(self, request: bytes, functional: bool, t_ns: int) -> list[bytes]:
        """Return the response to a request, or nothing."""
        mode = self._modes.get(request[0])
        try:
            found = b"" if mode is None else mode(request[1:])
        except (StoreError, _RefusedError):  # nothing was cleared, or it would come back at the next start
            self._note_clear(_CONDITIONS_NOT_CORRECT, functional)
            return [bytes([0x7F, request[0], _CONDITIONS_NOT_CORRECT])]
        if found:
            return [bytes([request[0] + 0x40]) + found]
        if mode is not None and request[0] == 0x04 and len(request) == 1:
            self._note_clear(DONE, functional)
            return [b"\x44"]
        if functional:
            return []
        return [bytes([0x7F, request[0], _NOT_SUPPORTED if mode is None else _NO_SUCH_PARAMETER])]

    def pending(self, request: bytes) -> list[bytes]:
        """Return 0x78: a physical request is always answered."""
        return [bytes([0x7F, request[0], _RESPONSE_PENDING])]

    def _note_clear(self, outcome: int, functional: bool) -> None:
        by = (self._params.functional or 0) if functional else self._params.request
        self._control.note(Intervention(0, "obd", self._bus, by, "obd_clear", b"\x04", outcome))

    def _related(self) -> list[Entry]:
        return [entry for entry in self._memory.entries() if self._memory.definition(entry.fault).emission_related]

    def _x01_current_data(self, rest: bytes) -> bytes:
        if not 1 <= len(rest) <= MOST_PIDS:
            return b""
        made = b""
        for pid in rest:
            data = self._current(pid)
            if data:
                made += bytes([pid]) + data
        return made

    def _current(self, pid: int) -> bytes:
        if pid % 0x20 == 0:
            bitmap = _bitmap(pid, (0x01, 0x1C, 0x41, *self._pids, *driven_pids(self._memory.usage.driven())))
            return bitmap if pid == 0 or any(bitmap) else b""
        if pid == 0x01:
            count = len(_codes(e for e in self._related() if e.status & Status.CONFIRMED_DTC))
            return bytes([self._memory.is_mil_on() << 7 | min(count, 0x7F)]) + readiness(self._memory).obd_bytes
        if pid == 0x1C:
            return bytes([self._params.standard])
        if pid == 0x41:
            return b"\x00" + readiness(self._memory, this_cycle=True).obd_bytes
        if pid in self._pids:
            params = self._pids[pid]
            return params.encode(self._control.value(params.signal))
        return driven_pids(self._memory.usage.driven()).get(pid, b"")

    def _frozen(self) -> tuple[Entry, FreezeFrame] | None:
        """Return the freeze frame that OBD shows: of the DTC that failed first of those still there."""
        shown = Status.PENDING_DTC | Status.CONFIRMED_DTC
        for entry in self._memory.in_order("first_failed"):
            related = self._memory.definition(entry.fault).emission_related
            if related and entry.freeze_frames and entry.status & shown:
                return entry, entry.freeze_frames[0]
        return None

    def _x02_freeze_frame(self, rest: bytes) -> bytes:
        """Frame 0 is the only one (J1979 asks for no more)."""
        if len(rest) % 2 or not 2 <= len(rest) <= 6:
            return b""
        found, made = self._frozen(), b""
        for pid, frame in zip(rest[::2], rest[1::2], strict=True):
            if frame != 0:
                continue
            data = b""
            if pid == 0x02:
                data = bytes(found[0].dtc)[:2] if found else b"\x00\x00"
            elif pid % 0x20 == 0:
                bitmap = _bitmap(pid, (0x02, *self._pids))
                data = bitmap if pid == 0 or any(bitmap) else b""
            elif found and pid in self._pids:
                params = self._pids[pid]
                data = params.encode(found[1].content.get(params.signal))
            if data:
                made += bytes([pid, frame]) + data
        return made

    def _dtcs(self, rest: bytes, bit: Status) -> bytes:
        """Modes 03 and 07: the number of DTCs, and their codes."""
        if rest:
            return b""
        codes = _codes(entry for entry in self._related() if entry.status & bit)
        return bytes([len(codes)]) + b"".join(codes)

    def _x04_clear(self, rest: bytes) -> bytes:
        if not rest:
            if self._authority.refusal("obd_clear", SESSIONLESS_ASKER):
                raise _RefusedError
            self._control.clear(EMISSION_DTCS)
        return b""

    def _x0a_permanent(self, rest: bytes) -> bytes:
        if rest:
            return b""
        faults = [permanent.fault for permanent in self._memory.permanent()]
        codes = _codes(self._memory.entry(fault) for fault in faults)
        return bytes([len(codes)]) + b"".join(codes)

    def _x09_vehicle_information(self, rest: bytes) -> bytes:
        """Several infotypes in one request, as for PIDs; of several, those that are there are answered."""
        if not 1 <= len(rest) <= MOST_PIDS:
            return b""
        made = b""
        for number in rest:
            data = self._information(number)
            if data:
                made += bytes([number]) + data
        return made

    def _information(self, number: int) -> bytes:
        """Return an infotype: how many items it has, and its data; or which of 32 there are."""
        there = self._infotypes()
        if number % 0x20 == 0:
            bitmap = _bitmap(number, there)
            return bitmap if number == 0 or any(bitmap) else b""
        if number not in there:
            return b""
        items = TRACKED if number == 0x08 else 1
        return bytes([items]) + there[number]

    def _infotypes(self) -> dict[int, bytes]:
        p = self._params
        known = {
            0x02: None if p.vin is None else p.vin.encode(),
            0x04: None if p.calibration is None else p.calibration.encode().ljust(16, b"\0"),
            0x06: None if p.calibration_check is None else p.calibration_check.to_bytes(4, "big"),
            0x08: tracking(self._memory.performance) if self._memory.performance.offered else None,
            0x0A: None if p.ecu_name is None else p.ecu_name.encode().ljust(20, b"\0"),
        }
        return {number: data for number, data in known.items() if data is not None}

    def identifier(self, number: int) -> bytes | None:
        """Return a data identifier of OBD on UDS (SAE J1979-2): F4xx PIDs, F6xx test results, F8xx infotypes."""
        page, number = number >> 8, number & 0xFF
        if page == 0xF4:
            return self._current(number) or None
        if page == 0xF6:
            return self._results(number, with_monitor=False) or None
        if page == 0xF8:
            data = self._information(number)
            return (data if number % 0x20 == 0 else data[1:]) or None
        return None

    def _results(self, number: int, *, with_monitor: bool) -> bytes:
        """Return the test results of a monitor, or which of 32 monitors there are."""
        if number % 0x20:
            return self._tests.of(number, with_monitor=with_monitor)
        bitmap = _bitmap(number, self._tests.numbers)
        head = bytes([number]) if with_monitor else b""
        return head + bitmap if number == 0 or any(bitmap) else b""

    def _x06_test_results(self, rest: bytes) -> bytes:
        """One monitor, or up to six questions for which monitors there are."""
        several = len(rest) <= MOST_PIDS and not any(number % 0x20 for number in rest)
        if not (len(rest) == 1 or (rest and several)):
            return b""
        return b"".join(self._results(number, with_monitor=True) for number in rest)


def _codes(entries: Iterable[Entry]) -> list[bytes]:
    """Return the two-byte codes, each once: OBD has no failure type byte. At most 255."""
    return sorted({bytes(entry.dtc)[:2] for entry in entries})[:255]
