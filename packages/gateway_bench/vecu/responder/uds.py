"""A UDS server that knows some answers: ISO-TP by can-isotp, the scenario's time for all that it waits for.

Unknown requests are answered as ISO 14229-1 wants: serviceNotSupported where no request with this service is known,
requestOutOfRange else; nothing where the request came to all and nothing but that could be said (7.5.5).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import isotp

from gateway.bus.frames import EXTENDED, FD, ID_MASK, Frames, empty, payload, put
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
        self._params, self._bus, self._read = params, bus, read
        self._flag = EXTENDED if params.extended else 0
        self._now_ns = 0
        self._waiting: deque[isotp.CanMessage] = deque()
        self._sent: list[Frames] = []
        self._answers: deque[tuple[int, bytes]] = deque()  # due [ns], answer
        mode = isotp.AddressingMode.Normal_29bits if params.extended else isotp.AddressingMode.Normal_11bits
        address = isotp.Address(mode, txid=params.response, rxid=params.request)
        # The pause that a tester asks for would be taken by the machine's clock, which a scenario does not go by.
        settings = {"tx_padding": 0xCC, "override_receiver_stmin": 0.0, "rx_flowcontrol_timeout": 3_600_000}
        self._layer = isotp.TransportLayerLogic(self._receive, self._send, address, params=settings)

    def _receive(self, _timeout: float) -> isotp.CanMessage | None:
        return self._waiting.popleft() if self._waiting else None

    def _send(self, message: isotp.CanMessage) -> None:
        made = empty(1)
        flags = FD if message.is_fd else 0
        data = bytes(message.data)
        put(made, 0, self._now_ns, message.arbitration_id | self._flag, data, bus=self._bus, flags=flags)
        self._sent.append(made)

    def step(self, end_ns: int, heard: Frames) -> list[Frames]:
        """Take frames, and return what is sent until a time [ns]."""
        params = self._params
        for frame in heard:
            can_id, data = int(frame["can_id"]), payload(frame)
            self._now_ns = max(self._now_ns, int(frame["t_ns"]))
            if can_id == params.request | self._flag:
                self._waiting.append(
                    isotp.CanMessage(
                        arbitration_id=can_id & ID_MASK, data=data, extended_id=params.extended, is_fd=False
                    )
                )
                self._layer.process()
                while self._layer.available():
                    self._take(bytes(self._layer.recv() or b""))
            elif params.functional is not None and can_id == params.functional | self._flag:
                length = data[0] if data else 0  # a request to all is a single frame
                if 0 < length <= 7 and len(data) > length:
                    self._take(data[1 : 1 + length], to_all=True)
        while self._answers and self._answers[0][0] < end_ns and not self._layer.transmitting():
            due_ns, answer = self._answers.popleft()
            self._now_ns = max(self._now_ns, due_ns)
            self._layer.send(answer)
            self._layer.process()
        if self._layer.transmitting():
            self._layer.process()
        sent, self._sent = self._sent, []
        self._now_ns = max(self._now_ns, end_ns - 1)
        return sent

    def _take(self, request: bytes, *, to_all: bool = False) -> None:
        answer = self.answer(request, to_all=to_all)
        if answer:
            self._answers.append((self._now_ns + round(self._params.delay_ms * 1e6), answer))

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
