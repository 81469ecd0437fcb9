"""ISO-TP (ISO 15765-2) for a server: requests in, responses out, driven by frames and by the time it is given.

The protocol is can-isotp's ``TransportLayerLogic``, without its thread; its timers run on our time, so that a
replay does what the live run did, and nothing sleeps.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, cast

import isotp
import numpy as np
from isotp.protocol import PDU
from numpy.typing import NDArray
from pydantic import Field

from gateway.bus.frames import BRS, EXTENDED, FD, Frames, empty, payload, put
from gateway.common.tomlfile import StrictModel
from gateway.servers.base import NEVER, Output

#: Wait frames in a row that a tester may send.
MOST_WAITS = 16
#: Responses on events that wait for the one under way.
MOST_PUSHED = 32

# What a tester sends wrongly is counted, not logged frame by frame.
_LOGGER = f"{__name__}.protocol"
logging.getLogger(_LOGGER).setLevel(logging.CRITICAL)


class IsoTpParams(StrictModel):
    """Addresses and transport of a diagnostic server."""

    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    request: int = Field(0x7E0, ge=0, le=0x1FFFFFFF, description="identifier of physical requests")
    functional: int | None = Field(
        0x7DF, ge=0, le=0x1FFFFFFF, description="identifier of functional requests"
    )
    response: int = Field(0x7E8, ge=0, le=0x1FFFFFFF, description="identifier of the answers")
    extended: bool | None = Field(
        None, description="29-bit identifiers; default: if one of them is above 0x7FF"
    )
    fd: bool = Field(False, description="answers in CAN FD frames of up to 64 bytes")
    padding: int | None = Field(0xCC, ge=0, le=255, description="fills frames up; none: short ones")
    block_size: int = Field(
        0, ge=0, le=255, description="frames a tester may send in a row, 0: all"
    )
    separation_ms: int = Field(0, ge=0, le=127, description="time between them [ms]")

    @property
    def flags(self) -> int:
        """Flag of its identifiers in a frame: EXTENDED or 0."""
        long = max(self.request, self.response, self.functional or 0) > 0x7FF
        return EXTENDED if self.extended or (self.extended is None and long) else 0


#: Takes a request, whether it was functional, and the time; returns the responses.
Answer = Callable[[bytes, bool, int], list[bytes]]


class _Clock:
    now_ns = 0


class _Timer:
    """can-isotp's timer on our time."""

    def __init__(self, clock: _Clock, timeout: float) -> None:
        self._clock = clock
        self._start_ns: int | None = None
        self.set_timeout(timeout)

    def set_timeout(self, timeout: float) -> None:
        self.timeout = int(timeout * 1e9)

    def start(self, timeout: float | None = None) -> None:
        if timeout is not None:
            self.set_timeout(timeout)
        self._start_ns = self._clock.now_ns

    def stop(self) -> None:
        self._start_ns = None

    def is_stopped(self) -> bool:
        return self._start_ns is None

    def is_timed_out(self) -> bool:
        return self._start_ns is not None and self._clock.now_ns >= self._start_ns + self.timeout

    @property
    def due_ns(self) -> int:
        return NEVER if self._start_ns is None else self._start_ns + self.timeout


class _Layer(isotp.TransportLayerLogic):
    """can-isotp's state machine, with our timers."""

    def __init__(self, clock: _Clock, *args: Any, **options: Any) -> None:
        self._clock = clock
        super().__init__(*args, **options)
        self.timer_tx_stmin = cast(Any, _Timer(clock, 0.0))

    def load_params(self) -> None:
        super().load_params()
        self.timer_rx_fc = self._timer(self.params.rx_flowcontrol_timeout)
        self.timer_rx_cf = self._timer(self.params.rx_consecutive_frame_timeout)

    def _timer(self, milliseconds: float) -> Any:
        return _Timer(self._clock, milliseconds / 1000)

    def _start_rx_fc_timer(self) -> None:
        self.timer_rx_fc = self._timer(self.params.rx_flowcontrol_timeout)
        self.timer_rx_fc.start()

    def _start_rx_cf_timer(self) -> None:
        self.timer_rx_cf = self._timer(self.params.rx_consecutive_frame_timeout)
        self.timer_rx_cf.start()

    @property
    def due_ns(self) -> int:
        timers = [self.timer_rx_fc, self.timer_rx_cf]
        if self.is_tx_transmitting_cf():
            timers.append(self.timer_tx_stmin)
        return min(int(cast(Any, timer).due_ns) for timer in timers)


class _Transport:
    """The transport layer of one address: frames received and to be sent, and requests and answers under way."""

    def __init__(self, params: IsoTpParams) -> None:
        self.clock = _Clock()
        self.received: deque[isotp.CanMessage] = deque()
        self.sent: list[isotp.CanMessage] = []
        self.errors = 0
        mode = (
            isotp.AddressingMode.Normal_29bits
            if params.flags
            else isotp.AddressingMode.Normal_11bits
        )
        self.layer = _Layer(
            self.clock,
            rxfn=lambda _timeout: self.received.popleft() if self.received else None,
            txfn=self.sent.append,
            address=isotp.Address(mode, txid=params.response, rxid=params.request),
            error_handler=self._on_error,
            params={
                "stmin": params.separation_ms,
                "blocksize": params.block_size,
                "tx_data_length": 64 if params.fd else 8,
                "tx_data_min_length": None if params.padding is None else 8,
                "tx_padding": params.padding,
                "can_fd": params.fd,
                "bitrate_switch": params.fd,
                "wftmax": MOST_WAITS,
                "max_frame_size": 4095,
                "logger_name": _LOGGER,
            },
        )

    def _on_error(self, _error: Exception) -> None:
        self.errors += 1


class IsoTpServer(Output):
    """One server address: a physical and a functional identifier in, one identifier out.

    While an answer is under way, further requests are not taken, as a tester has to wait for it
    (ISO 15765-3, half-duplex).

    Args:
        params: addresses and transport.
        bus: index of the bus.
        answer: what the server behind it does with a request.
        on_time: called as time passes, for answers that come later.
        next_ns: when it wants to be called.
    """

    normal = False
    prompt = True

    def __init__(
        self,
        params: IsoTpParams,
        bus: int,
        answer: Answer,
        on_time: Callable[[int], list[bytes]] = lambda _: [],
        next_ns: Callable[[], int] = lambda: NEVER,
    ) -> None:
        self._params = params
        self._bus = bus
        self._answer = answer
        self._on_time = on_time
        self._next_ns = next_ns
        self._transport = _Transport(params)
        self.dropped = 0
        flags = params.flags
        self._physical = params.request | flags
        self._functional = None if params.functional is None else params.functional | flags

    def succeed(self, old: Output, buses: Mapping[int, int]) -> None:
        """Keep requests and answers that are under way, if the addresses are the same."""
        if not isinstance(old, IsoTpServer) or buses.get(old._bus) != self._bus:
            return
        names = IsoTpParams.model_fields.keys() - {"bus"}
        if all(getattr(old._params, name) == getattr(self._params, name) for name in names):
            self._transport, self.dropped = old._transport, old.dropped

    def identifiers(self, bus: int) -> list[int] | None:
        """Return its request identifiers, if it is on this bus."""
        ids = [self._physical] if self._functional is None else [self._physical, self._functional]
        return ids if bus == self._bus else []

    def wanted(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames carry its request identifiers."""
        ids = frames["can_id"]
        mine = ids == self._physical
        if self._functional is not None:
            mine |= ids == self._functional
        return np.asarray(mine & (frames["bus"] == self._bus), np.bool_)

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take a frame of a request, or the flow control of an answer."""
        self._transport.clock.now_ns = max(self._transport.clock.now_ns, t_ns)
        can_id = int(frame["can_id"])
        message = isotp.CanMessage(
            can_id & 0x1FFFFFFF, data=payload(frame), extended_id=bool(can_id & EXTENDED)
        )
        if can_id == self._functional and can_id != self._physical:
            self._take_functional(message)
        else:
            self._transport.received.append(message)
            self._process()
        return self._take_sent()

    def _take_functional(self, message: isotp.CanMessage) -> None:
        """A functional request is a single frame (ISO 15765-2); anything else is passed over."""
        try:
            pdu = PDU(message)
        except ValueError:
            self._transport.errors += 1
            return
        if pdu.type != PDU.Type.SINGLE_FRAME or (pdu.can_dl > 8 and not pdu.escape_sequence):
            self._transport.errors += 1
            return
        self._serve(bytes(pdu.data), functional=True)
        self._process()

    def _process(self) -> None:
        self._transport.layer.process()
        while self._transport.layer.available():
            request = self._transport.layer.recv()
            if request is not None:
                self._serve(bytes(request), functional=False)
            self._transport.layer.process()

    def _serve(self, request: bytes, *, functional: bool) -> None:
        if not request or self._transport.layer.transmitting():
            return
        self._send(self._answer(request, functional, self._transport.clock.now_ns))

    def _send(self, responses: list[bytes]) -> None:
        for response in responses:
            self._transport.layer.send(response)

    def push(self, responses: list[bytes], t_ns: int) -> Frames:
        """Send responses that no request asked for just now, one after the other."""
        self._transport.clock.now_ns = max(self._transport.clock.now_ns, t_ns)
        room = max(MOST_PUSHED - self._transport.layer.tx_queue.qsize(), 0)
        self.dropped += max(len(responses) - room, 0)
        self._send(responses[:room])
        self._process()
        return self._take_sent()

    def on_time(self, t_ns: int) -> Frames:
        """Run separation times and timeouts, and send answers that come later."""
        self._transport.clock.now_ns = max(self._transport.clock.now_ns, t_ns)
        self._send(self._on_time(self._transport.clock.now_ns))
        self._process()
        return self._take_sent()

    @property
    def next_ns(self) -> int:
        """Time of the next timer of the transport or of the server."""
        return min(self._transport.layer.due_ns, self._next_ns())

    def counters(self) -> dict[str, int]:
        """Return frames that break ISO-TP, and responses on events that found no room."""
        return {"isotp_errors": self._transport.errors, "responses_dropped": self.dropped}

    def _take_sent(self) -> Frames:
        frames = empty(len(self._transport.sent))
        for k, message in enumerate(self._transport.sent):
            put(
                frames,
                k,
                self._transport.clock.now_ns,
                message.arbitration_id | (EXTENDED if message.is_extended_id else 0),
                bytes(message.data),
                bus=self._bus,
                flags=FD | BRS if message.is_fd else 0,
            )
        self._transport.sent.clear()
        return frames
