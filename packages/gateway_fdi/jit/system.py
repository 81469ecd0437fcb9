"""Functions of the system, for the kernels that wait: the daemon's pump for sockets, its journal for the disk.

All other kernels read no clock and touch nothing outside their arguments. Pointers are passed as integers. Each
function is that of the C library (POSIX, and Linux' ``recvmmsg``); what it returns is as its manual page says.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from functools import cache
from typing import Any, cast

from gateway_fdi.errors import KernelError
from gateway_fdi.jit.intrinsics import Intrinsic


@cache
def _in_python(name: str, result: str, arguments: tuple[str, ...]) -> Any:
    """Return the function for kernels that are plain Python; see :func:`_of_system`."""
    kinds = {
        "int32": ctypes.c_int32, "uint32": ctypes.c_uint32, "int64": ctypes.c_int64, "uint64": ctypes.c_uint64,
        "intp": ctypes.c_ssize_t,
    }  # fmt: skip
    function = getattr(ctypes.CDLL(None), name)
    function.restype, function.argtypes = kinds[result], [kinds[kind] for kind in arguments]
    return function


def _of_system(name: str, result: str, *arguments: str) -> Callable[..., int]:
    """Return a function of the C library as kernels call it.

    Args:
        name: its symbol.
        result: name of numba's type of the result.
        arguments: names of numba's types of the arguments.
    """

    def python(*values: Any) -> Any:
        return _in_python(name, result, arguments)(*map(int, values))

    def build(_ir: Any, kinds: Any) -> Any:
        signature = getattr(kinds, result)(*[getattr(kinds, kind) for kind in arguments])
        return kinds.ExternalFunction(name, signature)

    python.__name__ = name
    return cast("Callable[..., int]", Intrinsic(python, build))


#: poll(2): address of struct pollfd, how many, timeout [ms].
poll = _of_system("poll", "int32", "intp", "uint64", "int32")
#: recvmmsg(2): socket, address of struct mmsghdr, how many, flags, address of a timeout.
recvmmsg = _of_system("recvmmsg", "int32", "int32", "intp", "uint32", "int32", "intp")
#: send(2): socket, address of the data, bytes, flags.
send = _of_system("send", "intp", "int32", "intp", "uint64", "int32")
#: clock_gettime(2): which clock, address of struct timespec.
clock_gettime = _of_system("clock_gettime", "int32", "int32", "intp")
#: read(2), write(2): descriptor, address of the data, bytes.
read = _of_system("read", "intp", "int32", "intp", "uint64")
write = _of_system("write", "intp", "int32", "intp", "uint64")
#: pwrite(2): descriptor, address of the data, bytes, place in the file.
pwrite = _of_system("pwrite", "intp", "int32", "intp", "uint64", "int64")
#: fdatasync(2): descriptor.
fdatasync = _of_system("fdatasync", "int32", "int32")


def _call_bound(_address: int, _arguments: int, _results: int) -> int:
    """Call an entry whose arguments and results lie in cells; returns 0, or its status when it failed."""
    raise KernelError("only compiled kernels call an entry by its cells")


def _build_call_bound(ir: Any, types: Any) -> Any:
    def call_bound(_typing: Any, address: Any, arguments_at: Any, results_at: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            word = ir.IntType(64)
            kind = ir.FunctionType(ir.IntType(32), [word.as_pointer(), word.as_pointer()])
            target = builder.inttoptr(arguments[0], kind.as_pointer())
            cells = [builder.inttoptr(each, word.as_pointer()) for each in arguments[1:]]
            return builder.sext(builder.call(target, cells), word)

        return types.int64(types.int64, types.int64, types.int64), generate

    return call_bound


#: Calls an entry (:attr:`gateway_fdi.jit.kernels.Bound.address`) with its cells; returns 0, or its status if it failed.
call_bound: Callable[[int, int, int], int] = cast(Any, Intrinsic(_call_bound, _build_call_bound))


_changing = threading.Lock()


def _change_if(address: int, before: int, after: int) -> int:
    """Change an int64 that two threads share in one step, if it has a value; returns 1 if it had, else 0."""
    with _changing:
        cell = ctypes.c_int64.from_address(int(address))
        had = cell.value == before
        if had:
            cell.value = int(after)
        return int(had)


def _build_change_if(ir: Any, types: Any) -> Any:
    def change_if(_typing: Any, address: Any, before: Any, after: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            word = ir.IntType(64)
            place = builder.inttoptr(arguments[0], word.as_pointer())
            pair = builder.cmpxchg(place, arguments[1], arguments[2], "seq_cst", "seq_cst")
            return builder.zext(builder.extract_value(pair, 1), word)

        return types.int64(types.int64, types.int64, types.int64), generate

    return change_if


#: Changes an int64 that two threads share in one step, if it has a value; returns 1 if it had, else 0.
change_if: Callable[[int, int, int], int] = cast(Any, Intrinsic(_change_if, _build_change_if))
