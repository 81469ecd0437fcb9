"""Why a kernel failed that was called by its address.

An exception in compiled code leaves the address of its description, which the compiler has put beside the code: a
pickle of class, arguments, and (function, file, line) where it is known.
"""

from __future__ import annotations

import ctypes
import pickle

from gateway_fdi.jit.intrinsics import PYTHON_FAILURES
from gateway_fdi.jit.settings import COMPILED

#: Statuses are below it, addresses above.
_LEAST_ADDRESS = 4096


class _Description(ctypes.Structure):
    """The beginning of numba's description of an exception (its core/callconv.py)."""

    _fields_ = (("data", ctypes.c_void_p), ("length", ctypes.c_int32))


def failure_of(why: int) -> str:
    """Return in words what :func:`gateway_fdi.jit.call_entry` gave; it must not be 0."""
    if not COMPILED:
        return PYTHON_FAILURES[why - 1] if 0 < why <= len(PYTHON_FAILURES) else f"status {why}"
    if abs(why) < _LEAST_ADDRESS:
        return f"status {why}"
    found = _Description.from_address(why)
    try:
        kind, arguments, place = pickle.loads(ctypes.string_at(found.data, found.length))  # noqa: S301 - of our own code
        told = " ".join([f"{kind.__name__}:", *map(str, arguments)]) if arguments else str(kind.__name__)
    except Exception:  # of a class that cannot be imported any more
        return "an exception"
    return told if place is None else f"{told} ({place[1]}:{place[2]})"
