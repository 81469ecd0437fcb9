"""A bus's own condition: the kernel's error frames, and the gateway's frames of its condition.

An error frame (linux/can/error.h) has the flag ERROR and classes of errors as its identifier, and details in its data.
The kernel has no frame for an interface that goes away, comes back, or loses frames in a queue; for these the
gateway makes error frames of **no class**, which the kernel never sends. They travel with the other frames, into
recordings too, so that a replay judges the bus as the live run did.

Data of a frame without class: byte 0 the condition, bytes 4 to 7 the number of frames lost (little endian). STEPPED is
of the wall clock that stamps the frames rather than of a bus: bytes 1 to 7 are its step in microseconds, signed. Its
own stamp, and those of all frames after it, are of the clock after the step. OVERTIME is of a monitor whose step took
too long, at the time of that step: bytes 1 to 7 are a digest of its name.
"""

from __future__ import annotations

import re
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import ERROR, EXTENDED, ID_MASK, Frames, single

# Classes of errors: bits of the identifier.
TX_TIMEOUT, LOST_ARBITRATION, CONTROLLER, PROTOCOL = 0x001, 0x002, 0x004, 0x008
TRANSCEIVER, NO_ACK, BUS_OFF, BUS_ERROR = 0x010, 0x020, 0x040, 0x080
RESTARTED, COUNTERS = 0x100, 0x200

# Class CONTROLLER, byte 1 of the data.
RX_OVERFLOW, TX_OVERFLOW, RX_WARNING, TX_WARNING = 0x01, 0x02, 0x04, 0x08
RX_PASSIVE, TX_PASSIVE, ACTIVE = 0x10, 0x20, 0x40

#: Chip status of ASC -> counter of errors from which on it is so, byte 1 by the transmit and by the receive counter.
CHIP_STATES = {
    "error passive": (128, TX_PASSIVE, RX_PASSIVE),
    "warning level": (96, TX_WARNING, RX_WARNING),
    "error active": (0, ACTIVE, ACTIVE),
}

#: Conditions: frames come, none can come, some were lost in a queue; the wall clock was set; a monitor's step took too
#: long.
RUNNING, LOST, LOSS, STEPPED, OVERTIME = 1, 2, 3, 4, 5

#: An error frame in a text format that has no place for its classes.
_EXACT = re.compile(rb"SocketCAN ?= ?([0-9A-F]{8})#([0-9A-F]*)")


def exact(can_id: int, data: bytes) -> str:
    """Return an error frame as our writers of text have it behind what the format has."""
    return f"SocketCAN = {can_id & ~EXTENDED:08X}#{data.hex().upper()}"


def exact_in(line: bytes) -> tuple[int, bytes] | None:
    """Return the classes and data that :func:`exact` has put into a line; None: it has none."""
    found = _EXACT.search(line)
    return None if found is None else (int(found[1], 16) & ID_MASK, bytes.fromhex(found[2].decode()))


def condition_frame(t_ns: int, bus: int, condition: int, lost: int = 0) -> Frames:
    """Return a batch of one frame that tells the condition of a bus: RUNNING, LOST, or LOSS of ``lost`` frames."""
    data = bytes([condition, 0, 0, 0]) + min(lost, 0xFFFFFFFF).to_bytes(4, "little")
    return single(t_ns, ERROR, data, bus=bus)


def step_frame(t_ns: int, step_us: int) -> Frames:
    """Return a batch of one frame that tells a step of the wall clock, forward positive, and when it was noticed."""
    return single(t_ns, ERROR, bytes([STEPPED]) + step_us.to_bytes(7, "little", signed=True))


def overtime_frame(t_ns: int, name: str) -> Frames:
    """Return a batch of one frame that tells that a step of this monitor took too long, and when it was."""
    return single(t_ns, ERROR, bytes([OVERTIME]) + name_digest(name))


def name_digest(name: str) -> bytes:
    """Return the 7 bytes that stand for a monitor's name."""
    return blake2b(name.encode(), digest_size=7).digest()


def _reports(frames: Frames, condition: int) -> NDArray[np.bool_]:
    mask = frames["can_id"] == ERROR
    if mask.any():
        mask &= frames["data"][:, 0] == condition
    return np.asarray(mask, np.bool_)


def overtimes(frames: Frames) -> NDArray[np.intp]:
    """Return the places of frames that tell that a step took too long."""
    return np.flatnonzero(_reports(frames, OVERTIME))


def overtimes_in_place(frames: Frames) -> Frames:
    """Return frames of a recording with each such frame before the step that it tells of: it was written after it."""
    late = overtimes(frames)
    if not len(late):
        return frames
    others = np.delete(frames, late)
    return np.insert(others, np.searchsorted(others["t_ns"], frames["t_ns"][late]), frames[late])


def are_steps(frames: Frames) -> NDArray[np.bool_]:
    """Return which frames tell a step of the wall clock, shape (n,)."""
    return _reports(frames, STEPPED)


def are_conditions(frames: Frames) -> NDArray[np.bool_]:
    """Return which frames tell the condition of a bus or of the clock, shape (n,): only the gateway makes them."""
    return np.asarray(frames["can_id"] == ERROR, np.bool_)


def step_ns_of(frame: np.void) -> int:
    """Return the step that a frame tells [ns]."""
    return int.from_bytes(bytes(frame["data"][1:8]), "little", signed=True) * 1000
