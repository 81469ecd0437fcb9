"""Questions to one ECU, each once: what it is, what it supports, which DTCs it has; and what its answers say."""

from __future__ import annotations

from dataclasses import dataclass, field

from gateway.bus.frames import EXTENDED, ID_MASK
from gateway.common.times import NEVER
from gateway.config.ecu import OBD, ON_UDS, UDS, EcuParams
from gateway_ask.answers.answer_frames import NEGATIVE, FrameEncoder
from gateway_ask.answers.monitor_tests import Result, results
from gateway_ask.answers.obd_on_uds import as_classic
from gateway_ask.clients.ask import PROBES, Ask
from gateway_ask.clients.dtcs import read_dtcs
from gateway_ask.clients.ecu import SILENT, EcuClient
from gateway_ask.clients.poller import Ecu
from gateway_ask.clients.protocols import DTC_REQUESTS
from gateway_ask.clients.refusals import UNKNOWN

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
VIN_DID = b"\x22\xf1\x90"
#: Infotypes of OBD: its VIN; then, by the words of people, those that stand in maps, and the bytes of an item of them.
VIN_INFO, INFOTYPES = 0x02, {0x04: ("calibration", 16), 0x06: ("verification number", 4), 0x0A: ("name", 20)}
#: Services that only read, by a request that shows whether the ECU knows them.
SERVICES = {
    0x01: b"\x01\x00",
    0x03: b"\x03",
    0x06: b"\x06\x00",
    0x07: b"\x07",
    0x09: b"\x09\x00",
    0x0A: b"\x0a",
    0x19: b"\x19\x02\xaf",
    0x22: VIN_DID,
}
#: Requests for results of monitors, without the monitor's number.
_MONITORS = (b"\x06", b"\x22\xf6")
#: PIDs of one answer of support (SAE J1979: bit masks of 32).
_MASK = 32


def questions() -> list[Ask]:
    """Return the questions: those of support, the VIN, parts, DTCs."""
    asked = [*SERVICES.values(), PROBES[ON_UDS], _infotype(OBD, VIN_INFO)]
    asked += [*(b"\x22" + did.to_bytes(2, "big") for did in PARTS)]
    return [Ask(request, NEVER) for request in dict.fromkeys(asked)]


def _infotype(protocol: str, number: int) -> bytes:
    """Return the request for an infotype."""
    return bytes([0x22, 0xF8, number] if protocol == ON_UDS else [0x09, number])


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
        """Ask for the next map, where this one says that there is one, and for what it names; on UDS for all of it."""
        number, there = request[-1], supported(request, answer)
        more = [request[:-1] + bytes([number + _MASK])] if number + _MASK in there and number < 0xFF - _MASK else []
        if request == PROBES[ON_UDS] and there:
            more += [b"\x22\xf6\x00", _infotype(ON_UDS, 0), _infotype(ON_UDS, VIN_INFO)]
            more += [each for each, _ in DTC_REQUESTS[ON_UDS]]
        if request[:-1] in _MONITORS:
            more += [request[:-1] + bytes([each]) for each in there if each % _MASK]
        if request[:-1] in (b"\x09", b"\x22\xf8"):
            more += [request[:-1] + bytes([each]) for each in INFOTYPES if each in there]
        self.asks += [Ask(each, NEVER) for each in more]

    def _report(self, ask: Ask) -> None:
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
    return Ecu(Questioned(params, 0, questions()), FrameEncoder({}, {}, 1))


def supported(request: bytes, answer: bytes) -> list[int]:
    """Return the numbers that an answer to a request for a map names: PIDs, monitors, infotypes."""
    head = bytes([request[0] + 0x40]) + request[1:]
    if request[-1] % _MASK or request[0] not in (0x01, 0x06, 0x09, 0x22) or not answer.startswith(head):
        return []
    if len(answer) != len(head) + 4:
        return []
    mask = int.from_bytes(answer[-4:], "big")
    return [request[-1] + 1 + k for k in range(_MASK) if mask >> (_MASK - 1 - k) & 1]


@dataclass(frozen=True)
class Said:
    """All that an ECU has said.

    Attributes:
        answers: request -> answer.
    """

    answers: dict[bytes, bytes]

    def _data(self, request: bytes) -> bytes:
        """Return what a positive answer has behind what it repeats; b"": there is none."""
        head = bytes([request[0] + 0x40]) + request[1:]
        answer = self.answers.get(request, b"")
        return answer[len(head) :] if answer.startswith(head) else b""

    def _infotype(self, number: int, size: int) -> list[bytes]:
        """Return the items of an infotype, of this size each."""
        for protocol in PROBES:
            data = self._data(_infotype(protocol, number))
            if data:
                data = data[protocol == OBD or len(data) % size == 1 :]  # how many there are
                return [data[k : k + size] for k in range(0, len(data), size)]
        return []

    @property
    def vin(self) -> str:
        """Its VIN; "": it says none."""
        return text(self._data(VIN_DID) or b"".join(self._infotype(VIN_INFO, 17)))

    @property
    def speaks(self) -> list[str]:
        """Protocols of OBD that it answers."""
        return [protocol for protocol, request in PROBES.items() if self._data(request)]

    @property
    def parts(self) -> dict[str, str]:
        """Words -> what its identifiers say."""
        found = {words: text(self._data(b"\x22" + did.to_bytes(2, "big"))) for did, words in PARTS.items()}
        for number, (words, size) in INFOTYPES.items():
            items = self._infotype(number, size)
            found[words] = ", ".join(item.hex().upper() if size == 4 else text(item) for item in items)
        return {words: said for words, said in found.items() if said}

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
        return self._named(b"\x01", b"\x22\xf4")

    @property
    def monitors(self) -> list[int]:
        """Monitors whose test results it has."""
        return self._named(*_MONITORS)

    @property
    def tests(self) -> dict[int, list[Result]]:
        """Results of the tests of its monitors, as it has said them."""
        found = {}
        for monitor in self.monitors:
            said = [self._data(head + bytes([monitor])) for head in _MONITORS]
            data = said[0] or as_classic(0x06, monitor, said[1])
            found[monitor] = list(results(data))
        return {monitor: tests for monitor, tests in found.items() if tests}

    def _named(self, *pages: bytes) -> list[int]:
        """Return what the maps of pages name, without further maps."""
        maps = [each for each in self.answers.items() if each[0][:-1] in pages]
        return sorted({number for one in maps for number in supported(*one) if number % _MASK})

    @property
    def reads_dtcs(self) -> str:
        """Protocol by which it has said its DTCs; "": none."""
        for protocol in (UDS, ON_UDS, OBD):
            answers = (self.answers.get(request, b"") for request, _ in DTC_REQUESTS[protocol])
            if any(answer and answer[0] != NEGATIVE for answer in answers):
                return protocol
        return ""

    @property
    def dtcs(self) -> dict[str, int]:
        """DTCs with their status: of UDS the byte, of OBD a bit for each mode, as the vehicle's memory has them."""
        found: dict[str, int] = {}
        for request, _ in DTC_REQUESTS.get(self.reads_dtcs, ()):
            answer = self.answers.get(request)
            told = read_dtcs("", answer, request) if answer else None
            for dtc, status in told.found.items() if told is not None else ():
                found[dtc] = found.get(dtc, 0) | status
        return found


def text(data: bytes) -> str:
    """Return bytes as people read them: a text, or hexadecimal digits."""
    stripped = data.strip(b"\0 \xff")
    if stripped and all(0x20 <= byte < 0x7F for byte in stripped):
        return stripped.decode()
    return data.hex().upper()
