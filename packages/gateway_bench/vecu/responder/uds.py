"""A UDS server that knows some answers: the scenario's time for all that it waits for.

Unknown requests are answered as ISO 14229-1 wants: serviceNotSupported where no request with this service is known,
requestOutOfRange else; nothing where the request came to all and nothing but that could be said (7.5.5).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from gateway.bus.frames import Frames
from gateway.common.times import NEVER
from gateway.isotp.endpoint import IsoTpEndpoint, Request
from gateway.isotp.params import IsoTpParams
from gateway_bench.vecu.responder.params import UdsStub

#: NRC: the service is not known; the parameters are not; of these, a request to all gets no answer.
SERVICE_NOT_SUPPORTED, OUT_OF_RANGE = 0x11, 0x31
#: Services with a sub-function, whose bit 7 asks for no positive answer.
WITH_SUB_FUNCTION = frozenset({0x10, 0x11, 0x19, 0x27, 0x28, 0x29, 0x31, 0x3E, 0x85, 0x87})
READ_IDENTIFIER, POSITIVE, NEGATIVE = 0x22, 0x40, 0x7F


class UdsResponder:
    """The server.

    Args:
        params: of the stub.
        bus: index of its bus.
        read: returns the bytes of an identifier.
    """

    def __init__(self, params: UdsStub, bus: int, read: Callable[[str], bytes]) -> None:
        self._params, self._read = params, read
        self._answers: deque[tuple[int, bytes]] = deque()  # due [ns], answer
        address = IsoTpParams.model_validate(params.model_dump(include=set(IsoTpParams.model_fields)))
        self._transport = IsoTpEndpoint(address, bus)

    def step(self, end_ns: int, heard: Frames) -> list[Frames]:
        """Take frames, and return what is sent until a time [ns]."""
        transport, sent = self._transport, []
        for frame in heard[transport.wanted(heard)]:
            request = transport.receive(frame, int(frame["t_ns"]))
            if request is not None:
                self._take(request)
            sent.append(transport.take_frames())
        while (due_ns := self._due_ns) < end_ns:
            now_ns = transport.advance(due_ns)
            ready = bool(self._answers) and self._answers[0][0] <= now_ns and not transport.sending
            transport.send([self._answers.popleft()[1]] if ready else [])
            sent.append(transport.take_frames())
        return sent

    @property
    def _due_ns(self) -> int:
        """When the next frame is due: of the answer under way, else of the next one."""
        waits = self._answers and not self._transport.sending
        return min(self._transport.next_ns, self._answers[0][0] if waits else NEVER)

    def _take(self, request: Request) -> None:
        answer = self.answer(request.data, to_all=request.functional)
        if answer:
            self._answers.append((request.t_ns + round(self._params.delay_ms * 1e6), answer))

    def answer(self, request: bytes, *, to_all: bool = False) -> bytes:
        """Return the answer to a request, nothing where there is none."""
        if not request:
            return b""
        quiet = request[0] in WITH_SUB_FUNCTION and len(request) > 1 and bool(request[1] & 0x80)
        plain = bytes([request[0], request[1] & 0x7F, *request[2:]]) if quiet else request
        found = self._found(plain)
        if found is None:
            services = {int(text[:2], 16) for text in self._params.answers}
            known = plain[0] in services or (plain[0] == READ_IDENTIFIER and bool(self._params.identifiers))
            code = OUT_OF_RANGE if known else SERVICE_NOT_SUPPORTED
            return b"" if to_all else bytes([NEGATIVE, plain[0], code])
        return b"" if quiet and found[0] != NEGATIVE else found

    def _found(self, request: bytes) -> bytes | None:
        text, answers = request.hex(), self._params.answers
        if text in answers:
            return bytes.fromhex(answers[text])
        if request[0] == READ_IDENTIFIER and len(request) >= 3 and len(request) % 2:
            names = [request[k : k + 2].hex().upper() for k in range(1, len(request), 2)]
            known = {name.upper(): name for name in self._params.identifiers}
            if any(name in known for name in names):
                parts = (bytes.fromhex(name) + self._read(known[name]) for name in names if name in known)
                return bytes([READ_IDENTIFIER + POSITIVE]) + b"".join(parts)
        begins = [begin for begin in answers if begin.endswith("*") and text.startswith(begin[:-1])]
        return bytes.fromhex(answers[max(begins, key=len)]) if begins else None
