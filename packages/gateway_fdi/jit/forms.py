"""Forms of a kernel's arguments and results, and their place in the cells that carry them.

Compiled kernels have one C signature, ``int32 entry(const int64 *arguments, int64 *results)``. A form says what an
argument is, and so how it lies in the 8-byte cells:

========  =======================================================  =====================================
form      Python                                                   cells
========  =======================================================  =====================================
INT       int, a NumPy integer                                     1
UINT      numpy.uint64                                             1
FLOAT     float, numpy.float64                                     1
BOOL      bool, numpy.bool_                                        1
NONE      None                                                     0
Arr       an array: data, then its shape, then its strides         1 + 2 ndim
Rec       a record of NumPy: its address                           1
Tup       a tuple, or a named one                                  those of its items, one after the other
Fun       a kernel: a constant of the compiled code                0
========  =======================================================  =====================================
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from gateway_fdi.jit.addresses import address_of_array, address_of_record

INT, UINT, FLOAT, BOOL, NONE = "i", "u", "f", "b", "n"

_CODES = {INT: "q", UINT: "Q", FLOAT: "d", BOOL: "q", NONE: ""}


class Arr(NamedTuple):
    """An array; ``contiguous`` in C order, ``writable``."""

    dtype: np.dtype[Any]
    ndim: int
    contiguous: bool
    writable: bool


class Rec(NamedTuple):
    """A record."""

    dtype: np.dtype[np.void]


class Tup(NamedTuple):
    """A tuple of a class."""

    cls: type
    items: tuple[Any, ...]


class Fun(NamedTuple):
    """A kernel that is handed to a kernel."""

    kernel: Any


#: One of the forms above.
Form = Any

_SCALARS: dict[type, str] = {
    int: INT,
    bool: BOOL,
    float: FLOAT,
    type(None): NONE,
    np.bool_: BOOL,
    np.uint64: UINT,
    np.float64: FLOAT,
    np.float32: FLOAT,
    **dict.fromkeys((np.int8, np.int16, np.int32, np.int64, np.uint8, np.uint16, np.uint32), INT),
}


def form_of(value: Any) -> Form:
    """Return the form of an argument.

    Raises:
        TypeError: no kernel can take it.
    """
    scalar = _SCALARS.get(type(value))
    if scalar is not None:
        return scalar
    if isinstance(value, np.ndarray):
        flags = value.flags
        return Arr(value.dtype, value.ndim, flags.c_contiguous, flags.writeable)
    if isinstance(value, np.void):
        return Rec(value.dtype)
    if isinstance(value, tuple):
        return Tup(type(value), tuple(map(form_of, value)))
    if hasattr(value, "py_func"):
        return Fun(value)
    if isinstance(value, int):
        return INT
    if isinstance(value, float):
        return FLOAT
    raise TypeError(f"a kernel cannot take a {type(value).__name__}")


def code_of(form: Form) -> str:
    """Return the codes of :mod:`struct` for the cells of a form."""
    if isinstance(form, str):
        return _CODES[form]
    if isinstance(form, Arr):
        return "q" * (1 + 2 * form.ndim)
    if isinstance(form, Rec):
        return "q"
    if isinstance(form, Tup):
        return "".join(map(code_of, form.items))
    return ""


def put_array(value: Any, cells: list[Any]) -> None:
    """Append the cells of an array."""
    cells.append(address_of_array(value))
    cells += value.shape
    cells += value.strides


def put(form: Form, value: Any, cells: list[Any]) -> None:
    """Append the cells of an argument."""
    if isinstance(form, str):
        if form != NONE:
            cells.append(int(value) if form == BOOL else value)
    elif isinstance(form, Arr):
        put_array(value, cells)
    elif isinstance(form, Rec):
        cells.append(address_of_record(value))
    elif isinstance(form, Tup):
        for item, one in zip(form.items, value, strict=True):
            put(item, one, cells)


_CONVERT: dict[str, Callable[[Any], Any]] = {BOOL: bool}


def take(form: Form, cells: Any, at: int = 0) -> tuple[Any, int]:
    """Return the value that lies in cells from ``at`` on, and where the next begins.

    Args:
        form: of a result: a scalar, NONE, or a tuple of such.
        cells: numbers as :func:`code_of` has them unpacked.
        at: where it begins.
    """
    if isinstance(form, Tup):
        items = []
        for item in form.items:
            value, at = take(item, cells, at)
            items.append(value)
        return tuple(items), at
    if form == NONE:
        return None, at
    convert = _CONVERT.get(form)
    return (cells[at] if convert is None else convert(cells[at])), at + 1


def dtype_text(dtype: np.dtype[Any]) -> str:
    """Return a dtype as text: the same for the same layout, with every version of NumPy."""
    if dtype.subdtype is not None:
        base, shape = dtype.subdtype
        return f"{dtype_text(base)}{list(shape)}"
    if dtype.fields is not None:
        fields = (f"{name}:{dtype.fields[name][1]}:{dtype_text(dtype.fields[name][0])}" for name in dtype.names or ())
        return f"{{{','.join(fields)};{dtype.itemsize}}}"
    return dtype.str


def text_of(form: Form) -> str:
    """Return a form as text, the same on every machine."""
    if isinstance(form, str):
        return form
    if isinstance(form, Arr):
        order = "C" if form.contiguous else "A"
        return f"{dtype_text(form.dtype)}*{form.ndim}{order}{'' if form.writable else 'r'}"
    if isinstance(form, Rec):
        return dtype_text(form.dtype)
    if isinstance(form, Tup):
        names = getattr(form.cls, "_fields", ())
        return f"{form.cls.__name__}{list(names)}({','.join(map(text_of, form.items))})"
    return f"{form.kernel.__module__}:{form.kernel.__qualname__}"


def parse_results(text: str) -> Form:
    """Read what :func:`text_of` has made of the form of results: scalars, and tuples of them."""
    found: list[list[Any]] = [[]]
    for sign in text.replace("tuple[]", ""):
        if sign == "(":
            found.append([])
        elif sign == ")":
            items = found.pop()
            found[-1].append(Tup(tuple, tuple(items)))
        elif sign != ",":
            found[-1].append(sign)
    return found[0][0]
