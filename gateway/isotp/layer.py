"""can-isotp's state machine on our time: no thread, no sleep, so that a replay does what the live run did."""

from __future__ import annotations

import logging
from collections import deque
from typing import Any, cast

import isotp
from isotp.protocol import PDU

from gateway.common.times import NEVER
from gateway.isotp.edges import CONSECUTIVE, FLOW_CONTROL, judge
from gateway.isotp.params import IsoTpParams

#: Wait frames in a row that a tester may send.
MOST_WAITS = 16

# A tester's wrong frames are counted, not logged one by one.
_LOGGER = f"{__name__}.protocol"
logging.getLogger(_LOGGER).setLevel(logging.CRITICAL)


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


class _Logic(isotp.TransportLayerLogic):
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


class IsoTpLayer:
    """The messages of one pair of identifiers, under way in both directions, at the time it is given.

    Args:
        params: addresses and transport.
        address: extended addressing: first byte of frames to us, and of ours; None: there is none.
    """

    def __init__(self, params: IsoTpParams, address: tuple[int, int] | None = None) -> None:
        self._before = b"" if address is None else bytes(address[:1])
        self._clock = _Clock()
        self._received: deque[isotp.CanMessage] = deque()
        self._shown: list[int] | None = []  # bytes of each frame of the message under way that is taken later
        self._sent: list[isotp.CanMessage] = []
        self.errors = 0
        kind, (ours, theirs) = ("Normal", (None, None)) if address is None else ("Extended", address)
        mode = isotp.AddressingMode[f"{kind}_{29 if params.flags else 11}bits"]
        self._logic = _Logic(
            self._clock,
            rxfn=lambda _timeout: self._received.popleft() if self._received else None,
            txfn=self._sent.append,
            address=isotp.Address(
                mode, txid=params.response, rxid=params.request, source_address=ours, target_address=theirs
            ),
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

    @property
    def now_ns(self) -> int:
        """The time that it has come to."""
        return self._clock.now_ns

    def advance(self, t_ns: int) -> int:
        """Set its clock, never back; returns what it shows. Nothing is done before :meth:`process`."""
        self._clock.now_ns = max(self._clock.now_ns, t_ns)
        return self._clock.now_ns

    def process(self) -> None:
        """Do what is due by now."""
        self._logic.process()

    def take(self, message: isotp.CanMessage) -> bytes | None:
        """Take a frame and do what is due; returns the message that it completes, None: none."""
        self._shown = []
        before = self._before
        if not message.data.startswith(before):  # to another address
            return None
        data, aborts = judge(bytes(message.data[len(before) :]), len(before))
        if aborts and self._logic.tx_state == self._logic.TxState.WAIT_FC:
            self._logic.stop_sending()
        if data is None:
            self.errors += 1
            self._logic.process()
            return None
        message.data = before + data
        self._received.append(message)
        self._logic.process()
        whole = self._logic.recv()
        return None if whole is None else bytes(whole)

    def completed_by(self, data: bytes) -> bytes | None:
        """Return what has come of the message under way, if a frame that is taken later completes it; None: not so.

        Args:
            data: content of the next frame that is taken later; each is shown once, in its order.
        """
        logic, kind = self._logic, data[0] >> 4
        if kind == FLOW_CONTROL or self._shown is None:
            return None
        expected = (logic.last_seqnum + len(self._shown) + 1) & 0xF
        if kind != CONSECUTIVE or data[0] & 0xF != expected or logic.timer_rx_cf.is_timed_out():
            self._shown = None  # the message ends here, and is not answered
            return None
        self._shown.append(len(data) - 1)
        come = bytes(logic.rx_buffer)
        before = len(come) + sum(self._shown[:-1])
        return come if before < logic.rx_frame_length <= before + self._shown[-1] else None

    def content(self, data: bytes) -> bytes:
        """Return a frame's bytes behind the address; none of a frame to another one."""
        return data[len(self._before) :] if data.startswith(self._before) else b""

    def single(self, message: isotp.CanMessage) -> bytes | None:
        """Return what a single frame carries, leaving what is under way alone; None: it is no valid one."""
        try:
            pdu = PDU(message, len(self._before))
        except ValueError:
            self.errors += 1
            return None
        if pdu.type != PDU.Type.SINGLE_FRAME or (pdu.can_dl > 8 and not pdu.escape_sequence):
            self.errors += 1
            return None
        return bytes(pdu.data)

    def send(self, messages: list[bytes]) -> None:
        """Send messages one after the other, as far as possible by now."""
        for message in messages:
            self._logic.send(message)
        self._logic.process()

    @property
    def transmitting(self) -> bool:
        """Whether a message is being sent, or waits to be."""
        return bool(self._logic.transmitting())

    @property
    def receiving(self) -> bool:
        """Whether a message of several frames is being received."""
        return bool(self._logic.is_rx_active())

    @property
    def busy(self) -> bool:
        """Whether a message is under way, in either direction."""
        return self.transmitting or self.receiving

    @property
    def waiting(self) -> int:
        """Messages that wait for the one being sent."""
        return int(self._logic.tx_queue.qsize())

    def take_sent(self) -> list[isotp.CanMessage]:
        """Return the frames to be sent, once."""
        sent = self._sent.copy()
        self._sent.clear()  # not a new list: can-isotp appends to this one
        return sent

    @property
    def next_ns(self) -> int:
        """Time of its next timer."""
        return self._logic.due_ns
