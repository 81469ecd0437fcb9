"""A connection of udsoncan to a bench's gateway: can-isotp in between, the bench's clock for all waiting."""

from __future__ import annotations

from collections import deque
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import isotp
import numpy as np

from gateway.bus.frames import EXTENDED, ID_MASK, Frames, payload
from gateway.servers.uds.params import UdsParams
from gateway_bench.pytest_plugin.bench import Bench
from gateway_fdi.errors import GatewayError, InputError

if TYPE_CHECKING:
    from udsoncan.client import Client

#: Steps of 1 ms in which a request must have been sent.
_MOST_STEPS = 10_000


class _Transport:
    """Requests and answers over ISO-TP."""

    def __init__(self, bench: Bench, params: UdsParams) -> None:
        self._bench, self._params = bench, params
        self._bus = 0 if params.bus is None else [bus.name for bus in bench.config.bus].index(params.bus)
        self._received: deque[isotp.CanMessage] = deque()
        long = bool(params.flags & EXTENDED)
        mode = isotp.AddressingMode.Normal_29bits if long else isotp.AddressingMode.Normal_11bits
        address = isotp.Address(mode, txid=params.request, rxid=params.response)
        data_length = 64 if params.fd else 8
        self._layer = isotp.TransportLayerLogic(
            self._receive, self._send, address, params={"tx_padding": 0xCC, "tx_data_length": data_length}
        )
        bench.on_frames(self._on_frames)

    def _receive(self, _timeout: float) -> isotp.CanMessage | None:
        return self._received.popleft() if self._received else None

    def _send(self, message: Any) -> None:
        can_id = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
        self._bench.send_frame(can_id, bytes(message.data), bus=self._bus, fd=message.is_fd)

    def _on_frames(self, frames: Frames) -> None:
        wanted = self._params.response | self._params.flags
        for frame in frames[np.logical_and(frames["can_id"] == wanted, frames["bus"] == self._bus)]:
            identifier = int(frame["can_id"]) & ID_MASK
            long = bool(self._params.flags & EXTENDED)
            self._received.append(
                isotp.CanMessage(
                    arbitration_id=identifier, data=payload(frame), extended_id=long, is_fd=self._params.fd
                )
            )

    def send(self, data: bytes) -> None:
        """Send a request.

        Raises:
            GatewayError: the gateway does not take it.
        """
        self._layer.send(data)
        for _ in range(_MOST_STEPS):
            self._layer.process()
            if not self._layer.transmitting():
                return
            self._bench.step()
        raise GatewayError("the gateway does not take the request: no flow control frame came")

    def receive(self, seconds: float) -> bytes | None:
        """Return an answer, None if there is none within this time [s] of the bench's clock."""
        end = self._bench.now_s + seconds
        while True:
            self._layer.process()
            if self._layer.available():
                return bytes(self._layer.recv() or b"")
            if self._bench.now_s >= end:
                return None
            self._bench.step()

    def clear(self) -> None:
        """Forget answers that were not taken."""
        self._received.clear()
        self._layer.clear_rx_queue()


def client_of(bench: Bench) -> Client:
    """Return a client of udsoncan, opened; times of its requests are the bench's.

    Raises:
        InputError: udsoncan is not installed, or the configuration has no UDS server.
    """
    if find_spec("udsoncan") is None:
        raise InputError("the fixture uds needs udsoncan: pip install udsoncan")
    params = bench.config.output.uds
    if params is None:
        raise InputError("the fixture uds needs a UDS server: the configuration has no [output.uds]")
    from udsoncan.client import Client  # noqa: PLC0415 - only where it is installed
    from udsoncan.connections import BaseConnection  # noqa: PLC0415
    from udsoncan.exceptions import TimeoutException  # noqa: PLC0415

    transport = _Transport(bench, params)

    class Connection(BaseConnection):  # type: ignore[misc, unused-ignore]
        """udsoncan's view of the transport."""

        opened = False

        def open(self) -> Connection:
            """Open it."""
            self.opened = True
            return self

        def close(self) -> None:
            """Close it."""
            self.opened = False

        def is_open(self) -> bool:
            """Whether it is open."""
            return self.opened

        def empty_rxqueue(self) -> None:
            """Forget answers that were not taken."""
            transport.clear()

        def specific_send(self, payload: bytes, timeout: float | None = None) -> None:
            """Send a request."""
            transport.send(payload)

        def specific_wait_frame(self, timeout: float | None = None) -> bytes:
            """Wait for an answer by the bench's clock."""
            found = transport.receive(2.0 if timeout is None else timeout)
            if found is None:
                raise TimeoutException(  # type: ignore[no-untyped-call, unused-ignore]
                    f"no answer within {timeout} s of the bench's clock"
                )
            return found

    client = Client(Connection())
    client.open()
    return client
