"""Compiled kernels: numba behind one decorator, its cache, and calls through an address.

Every numeric kernel of the gateway is decorated with :func:`kernel`. With ``NUMBA_DISABLE_JIT=1``
the same code runs as plain Python, for debugging and coverage.

Monitor kernels are reached like interrupt handlers: the vector table holds their addresses, and
:func:`call_entry` jumps there. So the engine is compiled once for all configurations, and a monitor
is compiled once for all engines.
"""

from __future__ import annotations

import ctypes
import hashlib
import inspect
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
import platformdirs
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core import config as _config
from numba.extending import intrinsic
from numba.np import arrayobj

F = TypeVar("F", bound=Callable[..., Any])

config = cast(Any, _config)
carray = cast(Any, numba).carray

#: True when kernels are compiled; False under ``NUMBA_DISABLE_JIT=1``.
COMPILED: bool = not config.DISABLE_JIT

f8, i8, i4, i2, i1 = "<f8", "<i8", "<i4", "<i2", "i1"
u4, u1 = "<u4", "u1"


def record(**fields: Any) -> np.dtype[np.void]:
    """Return an aligned record dtype; a field is a dtype, ``(dtype, length)`` or ``(dtype, shape)``.

    Raises:
        ValueError: a field has the name of an attribute that records of NumPy have: plain Python would not reach it.
    """
    taken = [name for name in fields if hasattr(np.record, name)]
    if taken:
        raise ValueError(f"records of NumPy have {', '.join(taken)} already")
    parts = [
        (name, form[0], form[1] if isinstance(form[1], tuple) else (form[1],))
        if isinstance(form, tuple)
        else (name, form)
        for name, form in fields.items()
    ]
    return cast("np.dtype[np.void]", np.dtype(cast(Any, parts), align=True))


def _source_digest() -> str:
    """Digest of the package's source.

    numba looks only at the file of the function itself; a kernel that calls one in another file
    would be served stale. A directory per state of the whole source cannot be stale.
    """
    digest = hashlib.blake2b(digest_size=8)
    root = Path(__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def cache_directory() -> Path:
    """Return where compiled kernels of this source are kept.

    ``GATEWAY_CACHE_DIR``, else numba's ``NUMBA_CACHE_DIR``, else the user's cache directory.
    """
    base = os.environ.get("GATEWAY_CACHE_DIR") or os.environ.get("NUMBA_CACHE_DIR")
    root = Path(base) if base else Path(platformdirs.user_cache_dir("ecu-gateway"))
    return root / f"kernels-{_source_digest()}"


CACHE = cache_directory()
config.CACHE_DIR = str(CACHE)


def cache_is_warm() -> bool:
    """Tell whether kernels of this source were compiled before."""
    return not COMPILED or any(CACHE.rglob("*.nbi"))


def _changed(path: Path) -> float:
    """When a file was changed; 0 if another process has just deleted it."""
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def prune_cache(keep: int = 3) -> None:
    """Delete the caches of older sources, all but the ``keep`` newest."""
    if not CACHE.parent.is_dir():
        return
    old = sorted(
        (path for path in CACHE.parent.glob("kernels-*") if path != CACHE),
        key=_changed,
        reverse=True,
    )
    for path in old[max(keep - 1, 0) :]:
        shutil.rmtree(path, ignore_errors=True)


def kernel(function: F) -> F:
    """Compile a scalar kernel: no GIL, IEEE arithmetic, division by zero as in NumPy, cached.

    Kernels are inlined into their callers, so that tables handed down in a tuple cost nothing.
    """
    compiled = numba.njit(
        cache=True, nogil=True, boundscheck=False, error_model="numpy", forceinline=True
    )(function)
    return cast(F, compiled)


#: Entries of plain Python by their number, which stands for the address when kernels are not compiled.
_PYTHON_ENTRIES: list[tuple[Callable[..., None], tuple[np.dtype[np.void], ...]]] = []


def record_at(address: int, dtype: np.dtype[np.void]) -> Any:
    """Return the record that lies at an address, as a view (not compiled code)."""
    raw = (ctypes.c_char * dtype.itemsize).from_address(address)
    return np.frombuffer(cast(Any, raw), dtype).view(np.recarray)[0]


def entry_point(step: Callable[..., None], records: tuple[np.dtype[np.void], ...]) -> int:
    """Give a kernel of records an address that :func:`call_entry` can jump to.

    Args:
        step: a kernel ``step(a, b, c, d)`` over four records.
        records: the dtypes of the four.

    Returns:
        the address; the compiled code lives as long as the process.
    """
    if not COMPILED:
        _PYTHON_ENTRIES.append((step, records))
        return len(_PYTHON_ENTRIES) - 1
    if (step, records) in _KNOWN:
        return _KNOWN[step, records]
    python = getattr(step, "py_func", step)
    name = f"{python.__name__}_entry"
    # The wrapper is given the file of its kernel, so that numba finds a place for it in the cache.
    source = f"def {name}(a, b, c, d):\n step(carray(a, 1)[0], carray(b, 1)[0], carray(c, 1)[0], carray(d, 1)[0])\n"
    scope: dict[str, Any] = {"step": step, "carray": carray, "__name__": python.__module__}
    exec(compile(source, inspect.getfile(python), "exec"), scope)
    signature = types.void(
        *(cast(Any, types).CPointer(numba.from_dtype(dtype)) for dtype in records)
    )
    entry = numba.cfunc(signature, cache=True)(scope[name])
    _KEPT.append(entry)
    _KNOWN[step, records] = int(cast(int, entry.address))
    return _KNOWN[step, records]


#: Compiled entries, kept alive: an address must outlive whoever asked for it.
_KEPT: list[Any] = []
#: Their addresses: types of monitor that share a kernel share its entry.
_KNOWN: dict[tuple[Any, tuple[np.dtype[np.void], ...]], int] = {}


@intrinsic
def _jump(_typing: Any, address: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Call the function at ``address`` with four pointers."""
    signature = types.void(types.int64, types.int64, types.int64, types.int64, types.int64)

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        function = ir.FunctionType(ir.VoidType(), [pointer] * 4)
        target = builder.inttoptr(arguments[0], function.as_pointer())
        builder.call(target, [builder.inttoptr(value, pointer) for value in arguments[1:]])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def _borrow(_typing: Any, array: Any) -> Any:
    """Return an array without its reference count."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        make: Any = arrayobj.make_array
        null: Any = cgutils.get_null_value
        view = make(signature.return_type)(context, builder, value=arguments[0])
        view.meminfo = null(view.meminfo.type)
        view.parent = null(view.parent.type)
        return view._getvalue()

    return array(array), generate


def _same(array: Any) -> Any:
    return array


#: Returns an array that is not reference-counted, for the length of a kernel's run: counting costs two
#: atomic operations at each use of an array that lies in a tuple.
borrow: Callable[[Any], Any] = cast(Any, _borrow) if COMPILED else _same


def _call_python(address: int, a: int, b: int, c: int, d: int) -> None:
    step, dtypes = _PYTHON_ENTRIES[int(address)]
    step(*(record_at(int(at), dtype) for at, dtype in zip((a, b, c, d), dtypes, strict=True)))


#: Calls the entry at an address with the addresses of its four records.
call_entry: Callable[[int, int, int, int, int], None] = (
    cast(Any, _jump) if COMPILED else _call_python
)


@intrinsic
def _count_trailing_zeros(_typing: Any, word: Any) -> Any:
    """Return the place of a word's lowest set bit; undefined for 0."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), generate


def _lowest_python(word: int) -> int:
    return (int(word) & -int(word)).bit_length() - 1


#: Returns the place of the lowest set bit of a word that is not 0 and not negative.
lowest_bit: Callable[[int], int] = cast(Any, _count_trailing_zeros) if COMPILED else _lowest_python
