"""The server that is tried: a question, its answers, and what was expected instead in plain words."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

import isotp
import pytest

from gateway.bus.frames import EXTENDED, ID_MASK
from gateway.isotp.layer import IsoTpLayer
from gateway.isotp.params import IsoTpParams
from gateway_conformance.wires import Heard, Wire

MS = 1_000_000
#: P2*: longest wait after 0x78 (ISO 14229-2, 7.2); wait for the first frame, until it is said that none came [ns].
P2_STAR_NS, PATIENCE_NS = 5000 * MS, 1000 * MS
#: P2 of the server (ISO 14229-2, 7.2), where it has not told another [ms].
P2_MS = 50
#: Codes: the service, sub-function, or either in this session, is not there; not now, or not by this tester.
NOT_THERE, NOT_NOW = (0x11, 0x12, 0x7E, 0x7F), (0x21, 0x22, 0x33, 0x34)
TESTER_PRESENT = "3E 00"


def shown(data: bytes) -> str:
    """Return bytes as people write them."""
    return data.hex(" ").upper()


def fails(asked: str, expected: str, came: str) -> NoReturn:
    """Fail a case in plain words."""
    pytest.fail(f"{asked}: expected {expected}; came: {came}", pytrace=False)


@dataclass(frozen=True)
class Answer:
    """The answer to a question.

    Attributes:
        request: its bytes.
        to: who was asked.
        came: final answers, without 0x78.
        waits: how often 0x78 came.
        took_ns: until the first frame came.
    """

    request: bytes
    to: str
    came: tuple[bytes, ...]
    waits: int = 0
    took_ns: int = 0

    def fails(self, expected: str) -> NoReturn:
        """Fail the case."""
        fails(f"asked {self.to} {shown(self.request)}", expected, ", ".join(map(shown, self.came)) or "nothing")

    def needs(self, good: bool, expected: str) -> None:
        """Fail the case unless something holds."""
        if not good:
            self.fails(expected)

    @property
    def refusal(self) -> int:
        """Negative response code; 0: none."""
        last = self.came[-1] if self.came else b""
        return last[2] if len(last) == 3 and last[:2] == bytes([0x7F, self.request[0]]) else 0

    def refused(self, *codes: int) -> None:
        """Expect one negative response with one of these codes."""
        words = " or ".join(f"7F {self.request[0]:02X} {code:02X}" for code in codes)
        self.needs(len(self.came) == 1 and self.refusal in codes, words)

    def positive(self, start: bytes) -> bytes:
        """Expect one positive response that begins so; returns it."""
        good = len(self.came) == 1 and self.came[0].startswith(start)
        self.needs(good, f"a positive response that begins with {shown(start)}")
        return self.came[0]

    def exactly(self, data: str) -> None:
        """Expect one response of these bytes."""
        self.needs(self.came == (bytes.fromhex(data),), data)


class Target(ABC):
    """A server at an address.

    Args:
        name: for messages.
        slack_ns: the way there and back, added to the standard's times.
        demanded: services, or services with sub-functions, in hex digits: a case that lacks them fails.

    Attributes:
        functional: whether it can be asked together with all others.
    """

    functional = True

    def __init__(self, name: str, slack_ns: int, demanded: Sequence[str]) -> None:
        self.name, self.slack_ns, self.demanded = name, slack_ns, demanded

    @abstractmethod
    def ask(self, request: str, *, functional: bool = False, patience_ns: int = PATIENCE_NS) -> Answer:
        """Send a request; returns all that comes until its final answer, or until patience ends."""

    @abstractmethod
    def rest(self, ns: int) -> None:
        """Let time pass, and ask nothing."""

    @abstractmethod
    def close(self) -> None:
        """End it."""

    def needs_functional(self) -> None:
        """Skip the case where there is no functional address."""
        if not self.functional:
            pytest.skip("no functional address is given")

    def silent(self, request: str, *, functional: bool = False) -> None:
        """Expect no answer: neither within P2, nor later, before that to the next question."""
        answer = self.ask(request, functional=functional, patience_ns=P2_MS * MS)
        answer.needs(not answer.came and not answer.waits, "no answer")
        self.ask(TESTER_PRESENT).exactly("7E 00")

    def positive(self, request: str, echo: int = 1) -> bytes:
        """Expect a positive response; the case is skipped where the server does not offer it.

        Args:
            request: hex digits.
            echo: bytes of the request after the service that the response repeats.

        Returns:
            the response.
        """
        answer = self.ask(request)
        sent = answer.request
        obd = sent[0] < 0x10
        absent = answer.refusal in (*NOT_THERE, 0x31) if obd or sent[0] == 0x22 else answer.refusal in NOT_THERE
        asked = sent.hex().upper()
        if not any(asked.startswith(one) for one in self.demanded):
            if absent or (obd and not answer.came):
                pytest.skip(f"{shown(sent)} is not supported")
            if answer.refusal in NOT_NOW:
                pytest.skip(f"{shown(sent)} is refused with {answer.refusal:02X}: not now, or not by this tester")
        return answer.positive(bytes([sent[0] + 0x40]) + sent[1 : 1 + echo])


class CanTarget(Target):
    """A server on a CAN bus, by ISO-TP in normal addressing, classic frames.

    Args:
        name: for messages.
        wire: the way there.
        params: its identifiers.
        address: on J1939; None: not tried.
        slack_ns: see :class:`Target`.
        demanded: the same.
    """

    def __init__(
        self, name: str, wire: Wire, params: IsoTpParams, address: int | None, slack_ns: int, demanded: Sequence[str]
    ) -> None:
        super().__init__(name, slack_ns, demanded)
        self.wire, self.params, self.address = wire, params, address
        self.functional = params.functional is not None
        swapped = {
            "request": params.response,
            "response": params.request,
            "functional": None,
            "extended": bool(params.flags),
        }
        self._mirror = params.model_copy(update=swapped)

    def send(self, data: bytes | str, *, functional: bool = False) -> None:
        """Send one frame as it is."""
        identifier = (
            self.params.functional if functional and self.params.functional is not None else self.params.request
        )
        self.wire.send(identifier | self.params.flags, bytes.fromhex(data) if isinstance(data, str) else data)

    def frames(self, ns: int, enough: Callable[[list[Heard]], bool] = lambda _: False) -> list[Heard]:
        """Return the server's frames of this time, or until there are enough."""
        until, found = self.wire.now_ns() + ns, list[Heard]()
        while not enough(found) and (rest := until - self.wire.now_ns()) > 0:
            found += [one for one in self.wire.wait(rest) if one.can_id == self.params.response | self.params.flags]
        return found

    def ask(self, request: str, *, functional: bool = False, patience_ns: int = PATIENCE_NS) -> Answer:
        """Send a request; returns all that comes until its final answer, or until patience ends."""
        data = bytes.fromhex(request)
        self.wire.wait(0)
        layer, begun = IsoTpLayer(self._mirror), self.wire.now_ns()
        until, first, waits = begun + patience_ns, 0, 0
        layer.advance(begun)
        if functional:
            self.send((bytes([len(data)]) + data).ljust(8, b"\xcc"), functional=True)
        else:
            layer.send([data])
        came: list[bytes] = []
        while not came:
            layer.advance(self.wire.now_ns())
            layer.process()
            for message in layer.take_sent():
                self.send(bytes(message.data))
            now = self.wire.now_ns()
            due = min(layer.next_ns, until if not layer.busy else now + 10 * PATIENCE_NS)
            if now >= until and not layer.busy:
                break
            for one in self.frames(max(due - now, 1), enough=bool):
                first = first or one.t_ns
                layer.advance(self.wire.now_ns())
                extended = bool(one.can_id & EXTENDED)
                whole = layer.take(isotp.CanMessage(one.can_id & ID_MASK, data=one.data, extended_id=extended))
                if whole is not None and whole[:1] == b"\x7f" and whole[2:] == b"\x78":
                    waits, until = waits + 1, self.wire.now_ns() + P2_STAR_NS + self.slack_ns
                elif whole:
                    came.append(whole)
        for message in layer.take_sent():
            self.send(bytes(message.data))
        return Answer(data, self.name, tuple(came), waits, max(first - begun, 0))

    def rest(self, ns: int) -> None:
        """Let time pass, and ask nothing."""
        self.frames(ns)

    def close(self) -> None:
        """Leave the bus."""
        self.wire.close()
