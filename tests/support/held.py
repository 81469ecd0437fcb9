"""What this process holds in memory, counted exactly and at no cost: for tests that nothing grows.

``tracemalloc`` tells where, but makes each allocation several times as slow.
"""

import ctypes
import gc
import sys
from typing import NamedTuple


class _Mallinfo2(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in (
        "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost",
    )]  # fmt: skip


class Held(NamedTuple):
    """Objects of up to 512 bytes (pymalloc), and bytes of all that is larger (the C library's malloc)."""

    objects: int
    large_bytes: int


def held():
    """Return what is held now, without what the garbage collector takes."""
    gc.collect()
    mallinfo2 = ctypes.CDLL(None).mallinfo2
    mallinfo2.restype = _Mallinfo2
    found = mallinfo2()
    return Held(sys.getallocatedblocks(), int(found.uordblks) + int(found.hblkhd))
