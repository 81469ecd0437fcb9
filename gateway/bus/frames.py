"""The frame batch: how CAN frames travel through the gateway.

A batch is a NumPy structured array of :data:`FRAME`. Live, a batch is what one readable event
delivered; in replay it is a chunk of a log. Both feed the same engine.

Invariants that every producer keeps: ``data`` beyond ``length`` is zero; of a remote frame ``length`` is the DLC, and
all of ``data`` is zero; ``can_id`` carries the
flags of a SocketCAN ``struct can_frame`` in its upper three bits; ``t_ns`` is the time stamp of the
frame's own clock in integer nanoseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    import can

EXTENDED = 0x8000_0000  # CAN_EFF_FLAG
REMOTE = 0x4000_0000  # CAN_RTR_FLAG
ERROR = 0x2000_0000  # CAN_ERR_FLAG
ID_MASK = 0x1FFF_FFFF
#: A whole message that was put together of several frames, or taken out of a container: no bus has such frames, and
#: what comes in with both flags is an error frame (:func:`of_bus`).
#: Its identifier is that of the message. One of more than 64 bytes is several frames, one after the other.
WOVEN = ERROR | REMOTE

FD = 0x01  # CAN FD format (CANFD_FDF)
BRS = 0x02  # bit-rate switch
ESI = 0x04  # error state indicator of the sender
OWN = 0x08  # sent by this process
MORE = 0x10  # the woven message goes on in the next frame

#: Rank of a frame to be sent: the order in which a bus takes frames when it cannot take all at once. A cyclic one gives
#: way to the next of its identifier. Frames received have rank 0.
ANSWER, URGENT, CYCLIC = 0, 1, 2

#: One frame, 80 bytes. ``data`` starts on a multiple of 8, so that it can be read as 64-bit words.
FRAME = np.dtype(
    [
        ("t_ns", "<i8"),
        ("can_id", "<u4"),
        ("bus", "u1"),
        ("flags", "u1"),
        ("length", "u1"),
        ("rank", "u1"),
        ("data", "u1", (64,)),
    ]
)

#: A batch: shape ``(n,)`` of :data:`FRAME`.
Frames = NDArray[np.void]

#: Payload lengths that CAN FD can carry (ISO 11898-1, DLC 0..15).
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


def empty(count: int) -> Frames:
    """Return a batch of ``count`` zeroed frames."""
    return np.zeros(count, FRAME)


#: A frame as plain bytes: NumPy copies records field by field, which takes ten times as long.
RAW = np.dtype((np.void, FRAME.itemsize))
#: Frames of a batch that is looked at one by one.
MAX_SMALL_BATCH = 16
#: Frames that are copied as records: to look at them as bytes takes as long (1 us).
_FEW = 40


def copied(frames: Frames) -> Frames:
    """Return a copy of a batch."""
    return frames.copy() if len(frames) <= _FEW else frames.view(RAW).copy().view(FRAME)


def chosen(frames: Frames, mask: NDArray[np.bool_]) -> Frames:
    """Return a copy of the frames of a batch that a mask, shape (n,), chooses."""
    return frames.view(RAW).take(np.flatnonzero(mask)).view(FRAME)


def have_data(frames: Frames) -> NDArray[np.bool_]:
    """Return which frames carry data of a message, shape (n,): all but remote and error frames."""
    flags = frames["can_id"] & WOVEN
    return np.asarray((flags == 0) | (flags == WOVEN), np.bool_)


def has_none_of(frames: Frames, ids: frozenset[int]) -> bool:
    """Return whether a batch has no frame of some identifiers (with EXTENDED), as most have none."""
    if len(frames) <= MAX_SMALL_BATCH:
        return ids.isdisjoint(frames["can_id"].tolist())
    found = np.ascontiguousarray(frames["can_id"])  # one look at memory that is far apart, for all identifiers
    return not any((found == mine).any() for mine in ids)


def joined(parts: Sequence[Frames]) -> Frames:
    """Return batches as one, which is the one itself if no other has frames."""
    some = [part for part in parts if len(part)]
    if len(some) <= 1:
        return some[0] if some else empty(0)
    if sum(map(len, some)) <= _FEW * len(some):
        return np.concatenate(some)
    return np.concatenate([part.view(RAW) for part in some]).view(FRAME)


def put(
    frames: Frames,
    index: int,
    t_ns: int,
    can_id: int,
    payload: bytes | bytearray | memoryview,
    *,
    bus: int = 0,
    flags: int = 0,
) -> None:
    """Write one frame into a batch.

    Args:
        frames: the batch.
        index: which frame of it.
        t_ns: time stamp [ns].
        can_id: identifier with the flags :data:`EXTENDED`, :data:`REMOTE`, :data:`ERROR`.
        payload: 0 to 64 bytes.
        bus: index of the bus.
        flags: :data:`FD`, :data:`BRS`, :data:`ESI`, :data:`OWN`.

    Raises:
        InputError: the payload is longer than 64 bytes.
    """
    length = len(payload)
    if length > 64:
        raise InputError("a CAN frame carries at most 64 bytes", key="payload", value=length)
    frame = frames[index]
    frame["t_ns"] = t_ns
    frame["can_id"] = can_id
    frame["bus"] = bus
    frame["flags"] = flags
    frame["length"] = length
    data = frame["data"]
    data[:length] = np.frombuffer(payload, np.uint8)
    data[length:] = 0


def single(t_ns: int, can_id: int, payload: bytes, *, bus: int = 0, flags: int = 0) -> Frames:
    """Return a batch of one frame (see :func:`put`)."""
    frames = empty(1)
    put(frames, 0, t_ns, can_id, payload, bus=bus, flags=flags)
    return frames


def payload(frame: np.void) -> bytes:
    """Return the payload of one frame, ``length`` bytes; a remote frame has none."""
    return b"" if int(frame["can_id"]) & REMOTE else bytes(frame["data"][: int(frame["length"])])


def of_bus(can_id: Any) -> Any:
    """Return an identifier, or an array of them, as a bus may have it: an error frame is no remote frame."""
    return can_id & ~((can_id & ERROR) << 1)  # REMOTE is the bit above ERROR


def nanoseconds(seconds: float) -> int:
    """Turn a library's float seconds into integer nanoseconds.

    A double at today's epoch has a spacing of 238 ns, so a stamp of a recorder that counts
    microseconds is restored exactly by rounding there; below 1e6 s full nanoseconds survive.
    """
    if abs(seconds) < 1e6:
        return round(seconds * 1e9)
    return round(seconds * 1e6) * 1000


def put_message(frames: Frames, index: int, message: can.Message, *, bus: int = 0) -> None:
    """Write a python-can message into a batch (see :func:`put`)."""
    error, remote = message.is_error_frame, message.is_remote_frame and not message.is_error_frame
    can_id = message.arbitration_id & ID_MASK | (EXTENDED if message.is_extended_id else 0)
    can_id |= (ERROR if error else 0) | (REMOTE if remote else 0)
    flags = 0 if message.is_rx else OWN
    if message.is_fd:
        flags |= FD | (BRS if message.bitrate_switch else 0) | (ESI if message.error_state_indicator else 0)
    body = bytes(min(message.dlc, 8)) if message.is_remote_frame else bytes(message.data)
    put(frames, index, nanoseconds(message.timestamp), can_id, body, bus=bus, flags=flags)


def to_message(frame: np.void, channel: Any = None) -> can.Message:
    """Return one frame as a python-can message; ``timestamp`` is float seconds there."""
    import can  # noqa: PLC0415 - slow to load

    can_id = int(frame["can_id"])
    flags = int(frame["flags"])
    return can.Message(
        timestamp=int(frame["t_ns"]) / 1e9,
        arbitration_id=can_id & ID_MASK,
        is_extended_id=bool(can_id & EXTENDED),
        is_remote_frame=bool(can_id & REMOTE),
        is_error_frame=bool(can_id & ERROR),
        is_fd=bool(flags & FD),
        bitrate_switch=bool(flags & BRS),
        error_state_indicator=bool(flags & ESI),
        is_rx=not flags & OWN,
        dlc=int(frame["length"]),
        data=payload(frame),
        channel=channel,
    )
