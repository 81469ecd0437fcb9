"""The kernel's ``struct can_frame`` and ``struct canfd_frame``: received straight into the batch array.

The layout of FRAME mirrors these structs: a datagram received at byte 8 of a record puts the identifier, and the
payload, in their places. So receiving costs one system call a batch (``recvmmsg``) and no Python object a frame.
"""

from __future__ import annotations

import ctypes
import os
import socket
import time
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.base import Statistics
from gateway.bus.frames import BRS, ERROR, ESI, FD, FRAME, OWN, REMOTE, Frames, empty
from gateway_fdi.jit import address_of_array, bound, kernel

# From linux/can.h, asm-generic/socket.h, linux/socket.h; not all are in the socket module.
CAN_MTU, CANFD_MTU = 16, 72
CANFD_BRS, CANFD_ESI, CANFD_FDF = 0x01, 0x02, 0x04
_SOL_SOCKET = int(socket.SOL_SOCKET)
_SO_TIMESTAMPNS, _SO_RXQ_OVFL = 35, 40
_MSG_CONFIRM = 0x800

_ALIGNED = np.dtype(np.uintp).itemsize
#: From the begin of ``struct cmsghdr`` to its data; a stamp and a count of lost frames with theirs (CMSG_SPACE).
_TO_DATA = _ALIGNED + 8
_ANCILLARY = 2 * _TO_DATA + 16 + _ALIGNED

#: Longest batch that is filled at one call.
MOST_FRAMES = 1024


#: ``struct msghdr``, ``struct mmsghdr`` and ``struct iovec`` of Linux.
_HEADER = np.dtype(
    [
        ("name", np.uintp),
        ("name_length", np.uint32),
        ("vector", np.uintp),
        ("vectors", np.uintp),
        ("control", np.uintp),
        ("control_length", np.uintp),
        ("flags", np.int32),
    ],
    align=True,
)
_MESSAGE = np.dtype([("header", _HEADER), ("length", np.uint32)], align=True)
_VECTOR = np.dtype([("base", np.uintp), ("length", np.uintp)], align=True)


@cache
def _system() -> Any:
    """Return Linux' recvmmsg(2)."""
    function = ctypes.CDLL(None, use_errno=True).recvmmsg
    function.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p]
    return function


@kernel
def _word(control: Any, at: int, count: int) -> int:
    """Return ``count`` bytes as a little-endian number."""
    value = np.int64(0)
    for k in range(count):
        value |= np.int64(control[at + k]) << np.int64(8 * k)
    return int(value)


@kernel
def _read_ancillary(
    control: Any, end: int, losses: Any, gaps: int, kept: int, now_ns: int, lost: int
) -> tuple[int, int, int]:
    """Read ``end`` bytes that came with a struct: its stamp, and the socket's count of lost frames.

    Arguments are as of :func:`settle`, of one struct; ``gaps`` are rows of ``losses`` so far.

    Returns:
        stamp [ns], the socket's count of lost frames, rows of ``losses``.
    """
    stamp, at = now_ns, 0
    while at + _TO_DATA <= end:
        length = _word(control, at, _ALIGNED)
        kind = _word(control, at + _ALIGNED + 4, 4)
        if _word(control, at + _ALIGNED, 4) == _SOL_SOCKET:
            data = at + _TO_DATA
            if kind == _SO_TIMESTAMPNS:
                stamp = _word(control, data, 8) * 1_000_000_000
                stamp += _word(control, data + 8, 8)
            elif kind == _SO_RXQ_OVFL:
                total = _word(control, data, 4)
                if total != lost:
                    losses[gaps, 0], losses[gaps, 1] = kept, (total - lost) & 0xFFFFFFFF
                    gaps += 1
                    lost = total
        if length < _TO_DATA:
            break
        at += (length + _ALIGNED - 1) // _ALIGNED * _ALIGNED
    return stamp, lost, gaps


@kernel
def _to_frame(f: Any, fd: bool, own: bool, stamp: int, bus: int) -> None:
    """Turn a record whose bytes from the 8th on are a received struct, whose length lies at ``bus``, into a frame."""
    length = int(min(np.int64(f["bus"]), 64 if fd else 8))
    can_id = np.int64(f["can_id"])
    if can_id & ERROR:
        f["can_id"] = can_id & ~REMOTE
    kept = 0 if np.int64(f["can_id"]) & REMOTE else length  # a remote frame has a length but no data
    raw = np.int64(f["flags"])
    flags = OWN if own else 0
    if fd:
        flags |= FD
        flags |= BRS if raw & CANFD_BRS else 0
        flags |= ESI if raw & CANFD_ESI else 0
    f["t_ns"] = stamp
    f["bus"] = bus
    f["flags"] = flags
    f["length"] = length
    f["rank"] = 0
    data = f["data"]
    for j in range(kept, 64):
        data[j] = 0


@kernel
def settle(
    messages: Any, control: Any, losses: Any, out: Any, count: int, bus: int, now_ns: int, lost: int
) -> tuple[int, int, int, int]:
    """Turn received structs, where they lie now, into frames; structs that are not frames are left out.

    Args:
        messages: headers, shape (>= count,) of struct mmsghdr; made ready for the next call.
        control: their ancillary data, uint8, shape (>= count, bytes).
        losses: int64, shape (n, 2): takes (place in the batch, frames lost before it).
        out: batch whose records were received at byte 8.
        count: how many messages.
        bus: index of the bus.
        now_ns: stamp of a frame that has none [ns].
        lost: the socket's count of lost frames so far, modulo 2**32.

    Returns:
        frames, messages that were none, the socket's count of lost frames, rows of ``losses``.
    """
    kept, rejected, gaps = 0, 0, 0
    for k in range(count):
        size = messages[k]["length"]
        header = messages[k]["header"]
        end = min(np.int64(header["control_length"]), control.shape[1])
        header["control_length"] = control.shape[1]  # the kernel has put in how much there was
        stamp, lost, gaps = _read_ancillary(control[k], end, losses, gaps, kept, now_ns, lost)
        if size not in (CAN_MTU, CANFD_MTU):
            rejected += 1 if size > 0 else 0
            continue
        if kept != k:
            out[kept] = out[k]
        own = np.int64(header["flags"]) & _MSG_CONFIRM != 0
        _to_frame(out[kept], size == CANFD_MTU, own, stamp, bus)
        kept += 1
    return kept, rejected, lost, gaps


class Room:
    """Memory into which a system call receives, for several sockets (a row each) the most frames of one call.

    Attributes:
        messages: struct mmsghdr, shape (sockets, most).
        vectors: struct iovec, of the same shape: where the structs go.
        control: their ancillary data, uint8, shape (sockets, most, bytes).
        gaps: int64, shape (sockets, most, 2): see :func:`settle`.
    """

    def __init__(self, sockets: int, most: int) -> None:
        shape = (sockets, most)
        self.messages = np.zeros(shape, _MESSAGE)
        self.vectors = np.zeros(shape, _VECTOR)
        self.control = np.zeros((*shape, _ANCILLARY), np.uint8)
        self.gaps = np.zeros((*shape, 2), np.int64)
        rows = np.arange(sockets * most, dtype=np.uintp).reshape(shape)
        self.vectors["length"] = CANFD_MTU
        header = self.messages["header"]
        header["vector"] = self.vectors.ctypes.data + rows * self.vectors.itemsize
        header["vectors"] = 1
        header["control"] = self.control.ctypes.data + rows * _ANCILLARY
        header["control_length"] = _ANCILLARY

    def headers(self, socket_: int) -> int:
        """Return the address of the headers of a socket."""
        return int(self.messages[socket_].ctypes.data)

    def receive_into(self, frames: Frames) -> None:
        """Have structs received into frames, shape (sockets, >= most): the first of each row."""
        sockets, most = self.vectors.shape
        rows = np.arange(sockets, dtype=np.uintp)[:, None] * frames.shape[1] + np.arange(most, dtype=np.uintp)
        self.vectors["base"] = frames.ctypes.data + rows * FRAME.itemsize + 8


class RawReceiver:
    """Receives ``can_frame`` and ``canfd_frame`` datagrams of a socket into batches.

    Args:
        sock: a CAN_RAW socket, or any datagram socket that carries these structs.
        statistics: whose counters are kept.

    Attributes:
        losses: (place in the last batch, frames lost right before it), as the kernel counted them.
        lost: frames lost so far as the kernel counts them, modulo 2**32.
    """

    def __init__(self, sock: socket.socket, statistics: Statistics) -> None:
        self._sock = sock
        self._statistics = statistics
        self.lost = 0
        self.losses: list[tuple[int, int]] = []
        self._room = Room(1, MOST_FRAMES)
        self._messages, self._gaps = self._room.messages[0], self._room.gaps[0]
        self._headers, self._into = self._room.headers(0), 0
        # Compiled before traffic, and for one kind of batch.
        self._settle = bound(settle, self._messages, self._room.control[0], self._gaps, rest=(empty(1), 0, 0, 0, 0))
        for option in (_SO_TIMESTAMPNS, _SO_RXQ_OVFL):
            try:
                sock.setsockopt(_SOL_SOCKET, option, 1)
            except OSError:
                continue  # the host's clock stamps instead; overflow is not seen

    def receive(self, out: Frames, bus: int) -> int:
        """Take what has come into a batch, from its beginning, without waiting; returns how many frames.

        Raises:
            OSError: as the socket says.
        """
        self.losses = []
        most = min(len(out), MOST_FRAMES)
        address = address_of_array(out)
        if address != self._into:
            self._room.receive_into(out[np.newaxis])
            self._into = address
        count = _system()(self._sock.fileno(), self._headers, most, socket.MSG_DONTWAIT, None)
        if count < 0:
            code = ctypes.get_errno()
            error = OSError(code, os.strerror(code))
            if isinstance(error, BlockingIOError | InterruptedError):
                return 0
            raise error
        kept, rejected, self.lost, gaps = self._settle(out, count, bus, time.time_ns(), self.lost)
        self.note(kept, rejected, self._gaps[:gaps])
        return int(kept)

    def fileno(self) -> int:
        """Return the socket, of which a pump may receive, and to which it may send, in these structs."""
        return self._sock.fileno()

    def note(self, received: int, rejected: int, gaps: NDArray[np.int64]) -> None:
        """Count what was received, here or by a pump; ``gaps``, shape (n, 2): places, and frames lost before them."""
        self.losses = [(at, lost) for at, lost in gaps.tolist()]
        self._statistics.overflow += sum(lost for _, lost in self.losses)
        self._statistics.rejected += rejected
        self._statistics.received += received


@kernel
def fill_struct(row: Any, wire: Any) -> int:
    """Write a frame, in cells, as a struct of the kernel into nine cells; returns its length [byte]."""
    header = row[1]
    flags = np.int64((header >> np.uint64(40)) & np.uint64(0xFF))
    length = int(np.int64((header >> np.uint64(48)) & np.uint64(0xFF)))
    word = (header & np.uint64(0xFFFFFFFF)) | (np.uint64(length) << np.uint64(32))
    size = CAN_MTU
    if flags & FD:
        size = CANFD_MTU
        bits = CANFD_FDF | (CANFD_BRS if flags & BRS else 0) | (CANFD_ESI if flags & ESI else 0)
        word |= np.uint64(bits) << np.uint64(40)
    wire[0] = word
    for j in range(1, size // 8):
        left = min(length - 8 * (j - 1), 8)  # bytes of this cell that count
        wire[j] = row[j + 1] & (~np.uint64(0) >> np.uint64(64 - 8 * left)) if left > 0 else np.uint64(0)
    return size


class Packer:
    """Makes ``struct can_frame`` or ``struct canfd_frame`` of frames; for one thread."""

    def __init__(self) -> None:
        self._frame, wire = empty(1), np.zeros(CANFD_MTU // 8, np.uint64)
        self._bytes = wire.view(np.uint8)
        self._fill = bound(fill_struct, self._frame.view(np.uint64), wire, rest=())

    def __call__(self, frame: np.void) -> bytes:
        """Return one frame as such a struct."""
        self._frame[0] = frame
        return self._bytes[: int(self._fill())].tobytes()
