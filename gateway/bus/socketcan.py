"""SocketCAN: the kernel's frames straight into the batch array.

The layout of FRAME mirrors ``struct can_frame``: a datagram received at byte 8 of a record puts the identifier,
and the payload, in their places. So receiving costs one system call a frame and a few array operations
a batch, and no Python object a frame.
"""

from __future__ import annotations

import os
import socket
import struct
import time
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from gateway.bus.base import Bus, Statistics
from gateway.bus.frames import (
    BRS,
    ESI,
    EXTENDED,
    FD,
    FRAME,
    ID_MASK,
    OWN,
    REMOTE,
    Frames,
    empty,
    payload,
)
from gateway.errors import BusError
from gateway.jit import kernel

# From linux/can.h, linux/can/raw.h, asm-generic/socket.h; not all are in the socket module.
_CAN_MTU, _CANFD_MTU = 16, 72
_CANFD_BRS, _CANFD_ESI, _CANFD_FDF = 0x01, 0x02, 0x04
_SOL_CAN_RAW = 101
_CAN_RAW_FILTER, _CAN_RAW_ERR_FILTER, _CAN_RAW_FD_FRAMES = 1, 2, 5
_SO_TIMESTAMPNS, _SO_RXQ_OVFL = 35, 40
_MSG_CONFIRM = 0x800

_TIMESPEC = struct.Struct("@qq")
_ANCILLARY = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(4)
_HEADER = struct.Struct("=IBBBB")
#: Most kernel filters worth setting; with more identifiers everything is taken.
MOST_FILTERS = 512

#: Longest batch that is filled at one call.
MOST_FRAMES = 1024


@kernel
def settle(out: Any, stamps: Any, sizes: Any, own: Any, count: int, bus: int) -> None:
    """Turn the structs' length and flags, where they lie now, into ours.

    Args:
        out: batch whose records were received at byte 8.
        stamps: int64, time stamps [ns].
        sizes: int64, sizes of the datagrams [byte].
        own: uint8, 1 for frames of this process.
        count: how many frames.
        bus: index of the bus.
    """
    for k in range(count):
        f = out[k]
        fd = sizes[k] == _CANFD_MTU
        length = min(np.int64(f["bus"]), 64 if fd else 8)
        if np.int64(f["can_id"]) & REMOTE:
            length = 0  # a remote frame has a length but no data
        raw = np.int64(f["flags"])
        flags = OWN if own[k] else 0
        if fd:
            flags |= FD
            flags |= BRS if raw & _CANFD_BRS else 0
            flags |= ESI if raw & _CANFD_ESI else 0
        f["t_ns"] = stamps[k]
        f["bus"] = bus
        f["flags"] = flags
        f["length"] = length
        f["reserved"] = 0
        data = f["data"]
        for j in range(length, 64 if fd else 8):
            data[j] = 0


class RawReceiver:
    """Receives ``can_frame`` and ``canfd_frame`` datagrams of a socket into batches.

    Args:
        sock: a CAN_RAW socket (or any datagram socket that carries these structs), not blocking.
        index: of the bus.
        statistics: whose counters are kept.
    """

    def __init__(self, sock: socket.socket, index: int, statistics: Statistics) -> None:
        self._sock = sock
        self._index = index
        self._statistics = statistics
        self._lost = 0
        self._stamps = np.zeros(MOST_FRAMES, np.int64)
        self._sizes = np.zeros(MOST_FRAMES, np.int64)
        self._own = np.zeros(MOST_FRAMES, np.uint8)
        settle(empty(0), self._stamps, self._sizes, self._own, 0, index)  # compiled before traffic
        for option in (_SO_TIMESTAMPNS, _SO_RXQ_OVFL):
            try:
                sock.setsockopt(socket.SOL_SOCKET, option, 1)
            except OSError:
                continue  # the host's clock stamps instead; overflow is not seen

    def receive(self, out: Frames) -> int:
        """Take what has come, without waiting; returns how many frames.

        Args:
            out: batch to fill from its beginning.

        Raises:
            OSError: as the socket says.
        """
        most = min(len(out), MOST_FRAMES)
        rows = out[:most].view(np.uint8).reshape(most, FRAME.itemsize)
        rows[:, 16:] = 0
        raw = memoryview(cast(Any, rows)).cast("B")
        receive = self._sock.recvmsg_into
        count, at = 0, 8
        while count < most:
            try:
                got, ancillary, flags, _ = receive([raw[at : at + _CANFD_MTU]], _ANCILLARY)
            except (BlockingIOError, InterruptedError):
                break
            if got not in (_CAN_MTU, _CANFD_MTU):
                if got == 0:  # the peer of a socket pair is gone
                    break
                self._statistics.rejected += 1
                rows[count, 8:] = 0
                continue
            self._stamps[count] = self._stamp(ancillary)
            self._sizes[count] = got
            self._own[count] = flags & _MSG_CONFIRM != 0
            count += 1
            at += FRAME.itemsize
        if count:
            settle(out, self._stamps, self._sizes, self._own, count, self._index)
        self._statistics.received += count
        return count

    def _stamp(self, ancillary: Sequence[tuple[int, int, bytes]]) -> int:
        stamp = 0
        for level, kind, data in ancillary:
            if level != socket.SOL_SOCKET:
                continue
            if kind == _SO_TIMESTAMPNS:
                seconds, rest = _TIMESPEC.unpack(data)
                stamp = seconds * 10**9 + rest
            elif kind == _SO_RXQ_OVFL:
                lost = int.from_bytes(data, "little")
                self._statistics.overflow += (lost - self._lost) & 0xFFFFFFFF
                self._lost = lost
        return stamp or time.time_ns()


def pack(frame: np.void) -> bytes:
    """Return one frame as ``struct can_frame`` or ``struct canfd_frame``."""
    data = payload(frame)
    flags = int(frame["flags"])
    if flags & FD:
        bits = _CANFD_FDF
        bits |= _CANFD_BRS if flags & BRS else 0
        bits |= _CANFD_ESI if flags & ESI else 0
        return _HEADER.pack(int(frame["can_id"]), len(data), bits, 0, 0) + data.ljust(64, b"\0")
    return _HEADER.pack(int(frame["can_id"]), len(data), 0, 0, 0) + data.ljust(8, b"\0")


class SocketCanBus(Bus):
    """A SocketCAN interface.

    Args:
        uri: as the user named it.
        index: stamped into every frame.
        interface: e.g. ``vcan0``.
        fd: take and send CAN FD frames.
        rcvbuf: receive buffer of the kernel [byte]; None leaves the system's.

    Raises:
        BusError: the kernel has no SocketCAN, or not this interface.
    """

    def __init__(
        self, uri: str, index: int, interface: str, *, fd: bool = True, rcvbuf: int | None = None
    ) -> None:
        super().__init__(uri, index)
        family = getattr(socket, "AF_CAN", None)
        if family is None:
            raise BusError(f"{uri}: this system has no SocketCAN: use loopback: or virtual:")
        try:
            self._socket = socket.socket(family, socket.SOCK_RAW, socket.CAN_RAW)
        except OSError as error:
            raise BusError(
                f"{uri}: this kernel has no SocketCAN ({error.strerror}): use loopback: or virtual:"
            ) from error
        try:
            if fd:
                self._socket.setsockopt(_SOL_CAN_RAW, _CAN_RAW_FD_FRAMES, 1)
            self._socket.setsockopt(_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, struct.pack("=I", ID_MASK))
            if rcvbuf is not None:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, rcvbuf)
            self._socket.bind((interface,))
        except OSError as error:
            self._socket.close()
            reason = error.strerror or os.strerror(error.errno or 0)
            raise BusError(
                f"{uri}: {reason}; see the interfaces with: ip link show type can; "
                f"make a virtual one: ip link add dev {interface} type vcan"
            ) from error
        self._socket.setblocking(False)
        self._receiver = RawReceiver(self._socket, index, self.statistics)

    def fileno(self) -> int:
        """Return the socket."""
        return self._socket.fileno()

    def receive(self, out: Frames) -> int:
        """Take what the kernel has queued."""
        try:
            return self._receiver.receive(out)
        except OSError as error:
            raise BusError(f"{self.uri}: {error.strerror}") from error

    def send(self, frames: Frames) -> None:
        """Send frames, in order."""
        for frame in frames:
            try:
                self._socket.send(pack(frame))
            except OSError as error:
                raise BusError(f"{self.uri}: frame not sent: {error.strerror}") from error
            self.statistics.sent += 1

    def set_filters(self, can_ids: Sequence[int]) -> None:
        """Let the kernel keep foreign frames back."""
        if not 0 < len(can_ids) <= MOST_FILTERS:
            return
        mask = ID_MASK | EXTENDED | REMOTE
        filters = b"".join(struct.pack("=II", can_id, mask) for can_id in can_ids)
        self._socket.setsockopt(_SOL_CAN_RAW, _CAN_RAW_FILTER, filters)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
