"""SocketCAN: a raw socket of a CAN interface."""

from __future__ import annotations

import errno
import os
import socket
import struct
from collections.abc import Sequence
from functools import cached_property

from gateway.bus.base import Bus
from gateway.bus.can_structs import Packer, RawReceiver
from gateway.bus.frames import EXTENDED, ID_MASK, REMOTE, Frames
from gateway_fdi.errors import BusError, UnsupportedError

# From linux/can/raw.h, asm-generic/socket.h; not all are in the socket module.
_SOL_CAN_RAW = 101
_CAN_RAW_FILTER, _CAN_RAW_ERR_FILTER, _CAN_RAW_RECV_OWN_MSGS, _CAN_RAW_FD_FRAMES = 1, 2, 4, 5
_SO_RCVBUFFORCE = 33

#: Most kernel filters worth setting; with more identifiers everything is taken.
MOST_FILTERS = 512
#: Receive buffer that is asked for [byte]; without privileges the system's rmem_max is what one gets. The system's
#: default holds some 270 frames: less than 40 ms of a busy bus.
RCVBUF = 4 << 20

#: Errors of a queue that is full now and will not be.
_BUSY = {errno.ENOBUFS, errno.EAGAIN, errno.EINTR, errno.ENOMEM}
#: Errors of one frame that this interface cannot carry (CAN FD on a classic one).
_UNFIT = {errno.EINVAL, errno.EMSGSIZE}


class SocketCanBus(Bus):
    """A SocketCAN interface.

    Args:
        uri: as the user named it.
        index: stamped into every frame.
        interface: e.g. ``vcan0``.
        fd: take and send CAN FD frames.
        rcvbuf: receive buffer of the kernel [byte].

    Raises:
        UnsupportedError: the kernel has no SocketCAN.
        BusError: there is no such interface, or it is down.
    """

    def __init__(self, uri: str, index: int, interface: str, *, fd: bool = True, rcvbuf: int = RCVBUF) -> None:
        super().__init__(uri, index)
        self._gone: str | None = None  # why nothing will come any more
        family = getattr(socket, "AF_CAN", None)
        if family is None:
            raise UnsupportedError(f"{uri}: this system has no SocketCAN: use loopback: or virtual:")
        try:
            self._socket = socket.socket(family, socket.SOCK_RAW, socket.CAN_RAW)
        except OSError as error:
            raise UnsupportedError(
                f"{uri}: this kernel has no SocketCAN ({error.strerror}): use loopback: or virtual:"
            ) from error
        try:
            self._set_up(interface, fd, rcvbuf)
        except OSError as error:
            self._socket.close()
            raise BusError(f"{uri}: {_help(error, interface)}") from error
        self._receiver = RawReceiver(self._socket, self.statistics)

    @cached_property
    def _pack(self) -> Packer:
        return Packer()

    def _set_up(self, interface: str, fd: bool, rcvbuf: int) -> None:
        sock = self._socket
        sock.setblocking(False)
        if fd:
            sock.setsockopt(_SOL_CAN_RAW, _CAN_RAW_FD_FRAMES, 1)
        sock.setsockopt(_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, struct.pack("=I", ID_MASK))
        try:
            sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, rcvbuf)
        except PermissionError:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, rcvbuf)
        sock.bind((interface,))
        # An interface that is down can be bound; the kernel says so here, once.
        code = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            raise OSError(code, os.strerror(code))

    def fileno(self) -> int:
        """Return the socket."""
        return self._socket.fileno()

    @property
    def raw(self) -> RawReceiver | None:
        """The receiver of its socket; None: the bus is gone."""
        return self._receiver if self._gone is None else None

    def receive(self, out: Frames) -> int:
        """Take what the kernel has queued; of a bus that is gone first what it had still received."""
        try:
            count = self._receiver.receive(out, self.index)
        except OSError as error:
            self._gone = f"{self.uri}: {_help(error, '')}"
            try:
                count = self._receiver.receive(out, self.index)
            except OSError:
                count = 0
        self.losses = self._receiver.losses
        if not count and self._gone is not None:
            raise BusError(self._gone)
        return count

    def send(self, frames: Frames) -> int:
        """Send frames, in order, as far as the queue takes them."""
        for k, frame in enumerate(frames):
            try:
                self._socket.send(self._pack(frame))
            except OSError as error:
                if error.errno in _BUSY:
                    return k
                if error.errno not in _UNFIT:
                    raise BusError(f"{self.uri}: frame not sent: {error.strerror}") from error
                self.statistics.refused += 1
            else:
                self.statistics.sent += 1
        return len(frames)

    def set_filters(self, can_ids: Sequence[int] | None) -> None:
        """Let the kernel keep foreign frames back."""
        if can_ids is None or not 0 < len(can_ids) <= MOST_FILTERS:
            filters = struct.pack("=II", 0, 0)  # everything
        else:
            mask = ID_MASK | EXTENDED | REMOTE
            filters = b"".join(struct.pack("=II", can_id, mask) for can_id in can_ids)
        try:
            self._socket.setsockopt(_SOL_CAN_RAW, _CAN_RAW_FILTER, filters)
        except OSError as error:
            raise BusError(f"{self.uri}: {_help(error, '')}") from error

    def set_echo(self, on: bool) -> bool:
        """Let the kernel return what this socket sends, once it is on the bus."""
        self._socket.setsockopt(_SOL_CAN_RAW, _CAN_RAW_RECV_OWN_MSGS, int(on))
        return on

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _help(error: OSError, interface: str) -> str:
    reason = error.strerror or os.strerror(error.errno or 0)
    if error.errno == errno.ENETDOWN:
        return f"{reason}; set it up: ip link set {interface or 'INTERFACE'} up"
    if interface:
        return (
            f"{reason}; see the interfaces with: ip link show type can; "
            f"make a virtual one: ip link add dev {interface} type vcan"
        )
    return reason
