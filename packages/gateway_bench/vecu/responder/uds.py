"""A UDS server that knows some answers: the scenario's time for all that it waits for.

Unknown requests are answered as ISO 14229-1 wants: serviceNotSupported where no request with this service is known,
requestOutOfRange else; nothing where the request came to all and nothing but that could be said (7.5.5).
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from gateway.bus.frames import Frames
from gateway.common.times import NEVER
from gateway.isotp.edges import CONSECUTIVE
from gateway.isotp.endpoint import IsoTpEndpoint, Request
from gateway.isotp.params import IsoTpParams
from gateway_bench.vecu.contract import Run, Truth
from gateway_bench.vecu.responder.faults import Drawn, ResponderFault, other_echo
from gateway_bench.vecu.responder.memory import DtcMemory
from gateway_bench.vecu.responder.params import UdsStub

#: NRC: the service is not known; the parameters are not; of these, a request to all gets no answer.
SERVICE_NOT_SUPPORTED, OUT_OF_RANGE = 0x11, 0x31
#: Services with a sub-function, whose bit 7 asks for no positive answer.
WITH_SUB_FUNCTION = frozenset({0x10, 0x11, 0x19, 0x27, 0x28, 0x29, 0x31, 0x3E, 0x85, 0x87})
READ_IDENTIFIER, POSITIVE, NEGATIVE, PENDING = 0x22, 0x40, 0x7F, 0x78
#: Negative response codes that no request to all gets (ISO 14229-1, 7.5.5).
QUIET = frozenset({0x11, 0x12, 0x31, 0x7E, 0x7F})
#: Bytes of an answer that one frame carries.
SINGLE_FRAME = 7


class _Owed(NamedTuple):
    """An answer that is due.

    Attributes:
        due_ns: when [ns].
        answer: its bytes.
        fault: of it.
        after: answer that comes when the fault is over; b"": this is it.
    """

    due_ns: int
    answer: bytes
    fault: ResponderFault | None = None
    after: bytes = b""


class UdsResponder:
    """The server.

    Args:
        params: of the stub.
        run: its bus, and who is told of faults.
        read: returns the bytes of an identifier.
        faults: of its answers.
    """

    def __init__(self, params: UdsStub, run: Run, read: Callable[[str], bytes], faults: Drawn) -> None:
        self._params, self._read, self._run, self._faults = params, read, run, faults
        self._memory = DtcMemory(params.dtc, params.protocol)
        self._owed: list[_Owed] = []  # in order of time
        self._begin()
        self._off_ns = 0  # until when it is off
        self._told: list[ResponderFault] = []

    def _begin(self) -> None:
        params = self._params.model_dump(include=set(IsoTpParams.model_fields))
        self._transport = IsoTpEndpoint(IsoTpParams.model_validate(params), self._run.bus)
        self._fault: ResponderFault | None = None  # of the answer under way

    def step(self, end_ns: int, heard: Frames) -> list[Frames]:
        """Take frames, and return what is sent until a time [ns]."""
        sent = []
        for frame in heard[self._transport.wanted(heard)]:
            t_ns = int(frame["t_ns"])
            if t_ns < self._off_ns:
                continue
            request = self._transport.receive(frame, t_ns)
            if request is not None:
                self._take(request)
            sent.append(self._leaving())
        while (due_ns := self._due_ns) < end_ns:
            now_ns = self._transport.advance(due_ns)
            ready = bool(self._owed) and self._owed[0].due_ns <= now_ns and not self._transport.sending
            self._transport.send([self._next()] if ready else [])
            sent.append(self._leaving())
        return sent

    @property
    def _due_ns(self) -> int:
        """When the next frame is due: of the answer under way, else of the next one."""
        waits = self._owed and not self._transport.sending
        return min(self._transport.next_ns, self._owed[0].due_ns if waits else NEVER)

    def _next(self) -> bytes:
        """Return the answer that is due first; one that a fault keeps waiting is announced once more, or comes."""
        owed = self._owed.pop(0)
        self._fault = owed.fault
        if owed.after and owed.fault is not None:
            due_ns = owed.due_ns + owed.fault.by_ns
            still = owed.fault.active(due_ns)
            self._owe(owed._replace(due_ns=due_ns) if still else _Owed(due_ns, owed.after))
        return owed.answer

    def _owe(self, owed: _Owed) -> None:
        insort(self._owed, owed, key=lambda each: each.due_ns)

    def _leaving(self) -> Frames:
        """Return the frames that leave, with the fault of their answer."""
        frames, fault = self._transport.take_frames(), self._fault
        if fault is None or fault.kind not in ("sequence", "reset"):
            return frames
        following = frames["data"][:, 0] >> 4 == CONSECUTIVE
        if not following.any():
            return frames
        first = int(np.flatnonzero(following)[0])
        if fault.kind == "reset":
            self._reset(fault, int(frames["t_ns"][first]))
            return frames[:first]
        numbers = frames["data"][following, 0]
        frames["data"][following, 0] = numbers & 0xF0 | (numbers + 1) & 0x0F
        return frames

    def _reset(self, fault: ResponderFault, t_ns: int) -> None:
        """Switch off for a while; what was under way is lost."""
        self._owed.clear()
        self._begin()
        self._off_ns = t_ns + fault.by_ns

    def _take(self, request: Request) -> None:
        answer = self.answer(request.data, request.t_ns, to_all=request.functional)
        if not answer:
            return None
        fault = self._faults.of(request.t_ns, request.data)
        due_ns = request.t_ns + round(self._params.delay_ms * 1e6)
        if fault is None:
            return self._owe(_Owed(due_ns, answer))
        if fault not in self._told:
            self._told.append(fault)
            self._run.note(Truth(request.t_ns, fault.kind, 1))
        service = request.data[0]
        if fault.kind == "slow":
            self._owe(_Owed(due_ns + fault.by_ns, answer))
        elif fault.kind == "pending":
            self._owe(_Owed(due_ns, bytes([NEGATIVE, service, PENDING]), fault, answer))
        elif fault.kind == "reading":
            number = self._params.values[request.data.hex()].raw(fault.number or 0)
            self._owe(_Owed(due_ns, answer[: len(request.data)] + number))
        elif fault.kind == "echo":
            self._owe(_Owed(due_ns, other_echo(answer) if answer[0] != NEGATIVE else answer))
        elif fault.kind == "refuse" and not (request.functional and fault.code in QUIET):
            self._owe(_Owed(due_ns, bytes([NEGATIVE, service, fault.code])))
        elif fault.kind == "reset" and len(answer) <= SINGLE_FRAME:
            self._reset(fault, request.t_ns)
        elif fault.kind in ("sequence", "reset"):
            self._owe(_Owed(due_ns, answer, fault))
        return None

    def answer(self, request: bytes, t_ns: int, *, to_all: bool = False) -> bytes:
        """Return the answer to a request that came at a time [ns], nothing where there is none."""
        if not request:
            return b""
        quiet = request[0] in WITH_SUB_FUNCTION and len(request) > 1 and bool(request[1] & 0x80)
        plain = bytes([request[0], request[1] & 0x7F, *request[2:]]) if quiet else request
        found = self._found(plain, t_ns)
        if found is None:
            services = {int(text[:2], 16) for text in (*self._params.answers, *self._params.values)}
            known = plain[0] in services or (plain[0] == READ_IDENTIFIER and bool(self._params.identifiers))
            code = OUT_OF_RANGE if known else SERVICE_NOT_SUPPORTED
            found = bytes([NEGATIVE, plain[0], code])
        if to_all and found[0] == NEGATIVE and found[2] in QUIET:
            return b""
        return b"" if quiet and found[0] != NEGATIVE else found

    def _found(self, request: bytes, t_ns: int) -> bytes | None:
        text, answers = request.hex(), self._params.answers
        if text in answers:
            return bytes.fromhex(answers[text])
        if text in self._params.values:
            return bytes([request[0] + POSITIVE]) + request[1:] + self._params.values[text].at(t_ns)
        if request[0] == READ_IDENTIFIER and len(request) >= 3 and len(request) % 2:
            names = [request[k : k + 2].hex().upper() for k in range(1, len(request), 2)]
            known = {name.upper(): name for name in self._params.identifiers}
            if any(name in known for name in names):
                parts = (bytes.fromhex(name) + self._read(known[name]) for name in names if name in known)
                return bytes([READ_IDENTIFIER + POSITIVE]) + b"".join(parts)
        if request[0] in self._memory.services and not any(begin.startswith(text[:2]) for begin in answers):
            return self._memory.answer(request, t_ns)
        begins = [begin for begin in answers if begin.endswith("*") and text.startswith(begin[:-1])]
        return bytes.fromhex(answers[max(begins, key=len)]) if begins else None
