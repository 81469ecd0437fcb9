"""What kernels need that Python cannot say: a call to an address, the lowest set bit of a word, reading ahead.

An intrinsic is a function of plain Python, and, when a kernel that uses it is compiled, a few instructions.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import isfunction
from typing import Any, cast

import numpy as np

from gateway_fdi.jit.records import LINE, record_at


class Intrinsic:
    """A function of plain Python with instructions of its own when compiled.

    Args:
        python: the function.
        build: (llvmlite.ir, numba.types) -> the body of numba's intrinsic, or a type of numba's.
    """

    def __init__(self, python: Callable[..., Any], build: Callable[[Any, Any], Any]) -> None:
        self._python = python
        self._build = build
        self._type: Any = None
        self.__name__ = python.__name__
        self.__doc__ = python.__doc__

    def __call__(self, *arguments: Any) -> Any:
        """Run the function of plain Python."""
        return self._python(*arguments)

    @property
    def _numba_type_(self) -> Any:
        """Type of this function, by which numba knows it."""
        if self._type is None:
            from llvmlite import ir  # noqa: PLC0415 - only when compiling
            from numba import types  # noqa: PLC0415
            from numba.core.registry import cpu_target  # noqa: PLC0415
            from numba.extending import intrinsic  # noqa: PLC0415

            typing: Any = cpu_target.typing_context
            made = self._build(ir, types)
            made = intrinsic(made) if isfunction(made) else made
            typing.refresh()  # numba learns of what was registered since
            self._type = typing.resolve_value_type(made)
        return self._type


#: Kernels of plain Python; their place, counted from 1, stands for the address when kernels are not compiled.
PYTHON_ENTRIES: list[tuple[Callable[..., None], tuple[np.dtype[np.void] | None, ...]]] = []


#: What went wrong in kernels of plain Python; :func:`call_entry` returned the place here, counted from 1.
PYTHON_FAILURES: list[str] = []


def _call_entry(address: int, a: int, b: int, c: int, d: int) -> int:
    """Call the entry at an address with the addresses of its four records.

    Returns:
        0, or what went wrong: for :func:`gateway_fdi.jit.failures.failure_of`.
    """
    step, dtypes = PYTHON_ENTRIES[int(address) - 1]
    given = zip((a, b, c, d), dtypes, strict=True)
    records = (at if dtype is None else record_at(int(at), dtype) for at, dtype in given)
    try:
        step(*records)
    except Exception as error:
        where, at = "", error.__traceback__
        while at is not None:  # the last line that is not NumPy's
            if at.tb_frame.f_globals.get("__name__", "").partition(".")[0] != "numpy":
                where = f"{at.tb_frame.f_code.co_filename}:{at.tb_lineno}"
            at = at.tb_next
        PYTHON_FAILURES.append(f"{type(error).__name__}: {error} ({where})")
        return len(PYTHON_FAILURES)
    return 0


def _build_call_entry(ir: Any, types: Any) -> Any:
    from numba.core import cgutils  # noqa: PLC0415

    def call_entry(_typing: Any, address: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
        signature = types.int64(*[types.int64] * 5)

        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            word, status = ir.IntType(64), ir.IntType(32)
            kind = ir.FunctionType(status, [word.as_pointer(), word.as_pointer()])
            cells = cgutils.alloca_once(builder, ir.ArrayType(word, 4))
            for k, value in enumerate(arguments[1:]):
                builder.store(value, cgutils.gep_inbounds(builder, cells, 0, k))
            first = cgutils.gep_inbounds(builder, cells, 0, 0)
            target = builder.inttoptr(arguments[0], kind.as_pointer())
            reason = cgutils.alloca_once_value(builder, ir.Constant(word, 0))
            code = builder.sext(builder.call(target, [first, reason]), word)
            told = builder.load(reason)
            failed = builder.icmp_signed("!=", code, ir.Constant(word, 0))
            known = builder.and_(failed, builder.icmp_signed("!=", told, ir.Constant(word, 0)))
            return builder.select(known, told, code)

        return signature, generate

    return call_entry


#: Calls the entry at an address with the addresses of its four records; returns 0, or what went wrong (see failures).
call_entry: Callable[[int, int, int, int, int], int] = cast(Any, Intrinsic(_call_entry, _build_call_entry))


def _lowest_bit(word: int) -> int:
    """Return the place of the lowest set bit of a word that is not 0 and not negative."""
    return (int(word) & -int(word)).bit_length() - 1


def _build_lowest_bit(ir: Any, types: Any) -> Any:
    def lowest_bit(_typing: Any, word: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

        return types.int64(types.int64), generate

    return lowest_bit


#: Returns the place of the lowest set bit of a word that is not 0 and not negative.
lowest_bit: Callable[[int], int] = cast(Any, Intrinsic(_lowest_bit, _build_lowest_bit))


def _read_ahead(record: Any) -> None:
    """Have the processor fetch a record's beginning, three lines of its cache, while it goes on with other things."""


def _build_read_ahead(ir: Any, types: Any) -> Any:
    def read_ahead(_typing: Any, record: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
            kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
            prefetch = builder.module.declare_intrinsic("llvm.prefetch", (byte,), kind)
            first = builder.bitcast(arguments[0], byte)
            for_writing, to_stay, data = (ir.Constant(number, value) for value in (1, 3, 1))
            for at in range(0, min(record.size, 3 * LINE), LINE):
                place = builder.gep(first, [ir.Constant(ir.IntType(64), at)])
                builder.call(prefetch, [place, for_writing, to_stay, data])
            return ir.Constant(ir.IntType(8).as_pointer(), None)

        return types.none(record), generate

    return read_ahead


#: Has the processor fetch the beginning of a record, three lines of its cache, while it goes on with other things.
read_ahead: Callable[[Any], None] = cast(Any, Intrinsic(_read_ahead, _build_read_ahead))
