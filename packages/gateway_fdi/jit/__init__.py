"""Compiled kernels: one decorator, its cache, and calls through an address.

Every numeric kernel of the gateway is decorated with :func:`kernel`. Its machine code comes with the package
(:mod:`gateway_fdi.jit.shipped`), or from the cache of this machine (:mod:`gateway_fdi.jit.cache`), or is made by numba
(:mod:`gateway_fdi.jit.frontend`) and LLVM (:mod:`gateway_fdi.jit.machine`); with ``NUMBA_DISABLE_JIT=1`` the same code
runs as plain Python. numba is imported only where something is compiled.

Monitor kernels are reached like interrupt handlers: the vector table holds their addresses, and
:func:`call_entry` jumps there. So the engine is compiled once for all configurations, and a monitor
is compiled once for all engines.
"""

from gateway_fdi.jit.addresses import address_of_array
from gateway_fdi.jit.closure import Closure
from gateway_fdi.jit.failures import failure_of
from gateway_fdi.jit.intrinsics import call_entry, lowest_bit, read_ahead
from gateway_fdi.jit.kernels import Bound, Kernel, Same, bound, cells_of, entry_point, kernel, python_entry, run_entry
from gateway_fdi.jit.records import (
    LINE,
    Meaning,
    Record,
    f8,
    f8s,
    i1,
    i2,
    i4,
    i4s,
    i8,
    i8s,
    labels,
    means,
    record,
    record_at,
    u1,
    u1s,
    u4,
    u8,
    u8s,
    zeros,
)
from gateway_fdi.jit.settings import BOUNDSCHECK, COMPILED, cache_directory

__all__ = [
    "BOUNDSCHECK",
    "COMPILED",
    "LINE",
    "Bound",
    "Closure",
    "Kernel",
    "Meaning",
    "Record",
    "Same",
    "address_of_array",
    "bound",
    "cache_directory",
    "call_entry",
    "cells_of",
    "entry_point",
    "f8",
    "f8s",
    "failure_of",
    "i1",
    "i2",
    "i4",
    "i4s",
    "i8",
    "i8s",
    "kernel",
    "labels",
    "lowest_bit",
    "means",
    "python_entry",
    "read_ahead",
    "record",
    "record_at",
    "run_entry",
    "u1",
    "u1s",
    "u4",
    "u8",
    "u8s",
    "zeros",
]  # fmt: skip
