"""Questions to one ECU, each once: what it is, what it supports, which DTCs it has; and what its answers say."""

from __future__ import annotations

from dataclasses import dataclass, field

from gateway.answers.weave import Weaver
from gateway.bus.frames import EXTENDED, ID_MASK
from gateway.clients.asking import Ecu
from gateway.clients.dtcs import told_by
from gateway.clients.ecu import SILENT, Ask, EcuClient
from gateway.clients.params import DTC_REQUESTS, EcuParams
from gateway.common.times import NEVER

#: Identifiers of a part (ISO 14229-1, Annex C.1), by the words of people.
PARTS = {
    0xF187: "part number",
    0xF188: "software number",
    0xF189: "software version",
    0xF18A: "supplier",
    0xF18C: "serial number",
    0xF191: "hardware number",
    0xF193: "hardware version",
    0xF197: "system name",
}
VIN_DID, VIN_INFO = b"\x22\xf1\x90", b"\x09\x02"
#: Services that only read, by a request that shows whether the ECU knows them.
SERVICES = {
    0x01: b"\x01\x00",
    0x03: b"\x03",
    0x07: b"\x07",
    0x09: b"\x09\x00",
    0x0A: b"\x0a",
    0x19: DTC_REQUESTS["uds"][0],
    0x22: VIN_DID,
}
#: Negative codes by which an ECU says that it does not know a service: at all, in this session.
UNKNOWN = (0x11, 0x7F)
#: PIDs of one answer of support (SAE J1979: bit masks of 32).
_MASK = 32


def questions(extra: tuple[bytes, ...] = ()) -> list[Ask]:
    """Return the questions: those of support, the VIN, parts, DTCs."""
    asked = [*SERVICES.values(), VIN_INFO, *(b"\x22" + did.to_bytes(2, "big") for did in PARTS), *extra]
    return [Ask(request, NEVER) for request in dict.fromkeys(asked)]


@dataclass
class Questioned(EcuClient):
    """A client that asks each question once, and keeps the answers.

    Attributes:
        answers: request -> answer, from the service on; b"": there was none.
    """

    answers: dict[bytes, bytes] = field(default_factory=dict)

    def on_answer(self, answer: bytes, t_ns: int) -> None:
        """Take an answer of the ECU, to us or to others."""
        ask = self._asked
        super().on_answer(answer, t_ns)
        if ask is not None and not self.busy and ask not in self.asks and ask.request not in self.answers:
            self.answers[ask.request] = answer
            self._ask_next(ask.request, answer)

    def _ask_next(self, request: bytes, answer: bytes) -> None:
        """Ask for the next mask of PIDs, where this one says that there is one."""
        if len(request) == 2 and request[0] in (0x01, 0x09) and request[1] % _MASK == 0:
            later = request[1] + _MASK
            if later in supported(request, answer) and later <= 0xFF - _MASK + 1:
                self.asks.append(Ask(bytes([request[0], later]), NEVER))

    def _tell(self, ask: Ask) -> None:
        """A refusal is an answer here."""

    def _absent(self, t_ns: int) -> None:
        ask = self._asked
        super()._absent(t_ns)
        if ask is not None:
            self.answers[ask.request] = b""
        if self.silent >= SILENT:
            self.answers |= {left.request: b"" for left in self.asks}
            self.asks.clear()

    @property
    def done(self) -> bool:
        """Whether all is asked."""
        return not self.busy and not self.asks


def questioned(name: str, request: int, response: int) -> Ecu:
    """Return an ECU that is asked all questions; its identifiers with EXTENDED."""
    long = bool(request & EXTENDED)
    params = EcuParams(name=name, request=request & ID_MASK, response=response & ID_MASK, extended=long)
    return Ecu(Questioned(params, 0, questions()), Weaver({}, {}, 1))


def supported(request: bytes, answer: bytes) -> list[int]:
    """Return the PIDs that an answer to a request for a mask names."""
    if answer[:2] != bytes([request[0] + 0x40, request[1]]) or len(answer) < 6:
        return []
    mask = int.from_bytes(answer[2:6], "big")
    return [request[1] + 1 + k for k in range(_MASK) if mask >> (_MASK - 1 - k) & 1]


@dataclass(frozen=True)
class Said:
    """All that an ECU has said.

    Attributes:
        answers: request -> answer.
    """

    answers: dict[bytes, bytes]

    @property
    def vin(self) -> str:
        """Its VIN; "": it says none."""
        by_did, by_info = self.answers.get(VIN_DID, b""), self.answers.get(VIN_INFO, b"")
        if by_did[:1] == b"\x62":
            return text(by_did[3:])
        return text(by_info[3:]) if by_info[:1] == b"\x49" else ""

    @property
    def parts(self) -> dict[str, str]:
        """Words -> what its identifiers say."""
        found = {}
        for did, words in PARTS.items():
            answer = self.answers.get(b"\x22" + did.to_bytes(2, "big"), b"")
            if answer[:1] == b"\x62":
                found[words] = text(answer[3:])
        return found

    @property
    def services(self) -> dict[int, bool | None]:
        """Service that reads -> whether it is known; None: no answer, so that nobody knows."""
        found: dict[int, bool | None] = {}
        for service, request in SERVICES.items():
            answer = self.answers.get(request, b"")
            refused = answer[:1] == b"\x7f" and len(answer) > 2 and answer[2] in UNKNOWN
            found[service] = None if not answer else not refused
        return found

    @property
    def pids(self) -> list[int]:
        """PIDs of current data, without those that only name others."""
        found = [
            pid for request, answer in self.answers.items() if request[0] == 0x01 for pid in supported(request, answer)
        ]
        return sorted(pid for pid in found if pid % _MASK)

    @property
    def dtcs(self) -> dict[str, int]:
        """DTCs with their status: of UDS the byte, of OBD a bit for each mode, as the vehicle's memory has them."""
        found: dict[str, int] = {}
        for request in DTC_REQUESTS["uds" if self.services[0x19] else "obd"]:
            answer = self.answers.get(request)
            told = told_by("", answer, request) if answer else None
            for dtc, status in told.found.items() if told is not None else ():
                found[dtc] = found.get(dtc, 0) | status
        return found


def text(data: bytes) -> str:
    """Return bytes as people read them: a text, or hexadecimal digits."""
    stripped = data.strip(b"\0 \xff")
    if stripped and all(0x20 <= byte < 0x7F for byte in stripped):
        return stripped.decode()
    return data.hex().upper()
