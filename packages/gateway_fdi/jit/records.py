"""Record dtypes of kernels, written as classes, and records at an address.

A record class is the dtype that kernels are compiled for and the type that a type checker sees, in one::

    class State(Record):
        lowest: f8 = means("lowest voltage so far", "V")
        history: Annotated[f8s, 8]
        rule: stopping.State

NumPy takes such a class wherever it takes a dtype.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import (
    Annotated,
    Any,
    ClassVar,
    NamedTuple,
    TypeAlias,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

#: Fields of records: the data of a kernel, and their layout in memory.
f8: TypeAlias = Annotated[float, "<f8"]
i8: TypeAlias = Annotated[int, "<i8"]
i4: TypeAlias = Annotated[int, "<i4"]
i2: TypeAlias = Annotated[int, "<i2"]
i1: TypeAlias = Annotated[int, "i1"]
u8: TypeAlias = Annotated[int, "<u8"]
u4: TypeAlias = Annotated[int, "<u4"]
u1: TypeAlias = Annotated[int, "u1"]
#: Arrays of them, of the shape that follows: ``Annotated[f8s, 3, 4]``.
f8s: TypeAlias = Annotated[NDArray[np.float64], "<f8"]
i8s: TypeAlias = Annotated[NDArray[np.int64], "<i8"]
i4s: TypeAlias = Annotated[NDArray[np.int32], "<i4"]
u8s: TypeAlias = Annotated[NDArray[np.uint64], "<u8"]
u1s: TypeAlias = Annotated[NDArray[np.uint8], "u1"]


#: Bytes of a line of the processor's cache.
LINE = 64


class Meaning(NamedTuple):
    """Meaning of a field, for people, and its unit; both may be empty."""

    text: str
    unit: str


def means(text: str = "", unit: str = "") -> Any:
    """Say what the field of a record is, and its unit."""
    return Meaning(text, unit)


class Record:
    """Base of records: each annotation is a field, in this order, those of a base class first.

    A field is a number (``f8``), an array (``Annotated[f8s, 3]``), another record, or an array of these
    (``Annotated[list[Other], 3]``). With ``class Union(Record, overlay=True)`` all fields lie in the same place: only
    one of them is in use at a time. A length may be a name, ``Annotated[f8s, "cells"]``, with ``class State(Record,
    lengths={"cells": 16})``: a class derived from it may say another length. Of a table with many rows ``near=("last",
    "counter")`` names what each step touches: it lies together, first in the row, and rows are an odd number of the
    cache's lines long, so that these parts of all rows are spread over the whole cache.

    Attributes:
        dtype: of NumPy, aligned as in C.
        meanings: of the fields that say one.

    Raises:
        TypeError: an annotation that is no field, or a length that is not given.
        ValueError: a field has the name of an attribute that records of NumPy have: plain Python would not reach it.
    """

    dtype: ClassVar[np.dtype[np.void]]
    meanings: ClassVar[Mapping[str, Meaning]]
    _lengths: ClassVar[Mapping[str, int]] = {}

    def __init_subclass__(
        cls, *, overlay: bool = False, lengths: Mapping[str, int] | None = None, near: tuple[str, ...] = ()
    ) -> None:
        cls._lengths = {**cls._lengths, **(lengths or {})}
        hints = get_type_hints(cls, include_extras=True)
        for base in cls.__bases__:
            for other in cls.__bases__:
                both = set(_names(base)) & set(_names(other))
                if base is not other and both and not (issubclass(base, other) or issubclass(other, base)):
                    raise TypeError(f"{cls.__qualname__}: two of its bases have {', '.join(sorted(both))}")
        forms = {name: _form(cls, name, hint) for name, hint in hints.items() if get_origin(hint) is not ClassVar}
        cls.dtype = record(**{**{name: forms[name] for name in near}, **forms})
        if near:
            cls.dtype = _in_lines(cls.dtype)
        if overlay:
            parts = [cls.dtype[name] for name in forms]
            cls.dtype = np.dtype(
                {
                    "names": list(forms),
                    "formats": parts,
                    "offsets": [0] * len(parts),
                    "itemsize": max(part.itemsize for part in parts),
                },
                align=True,
            )
        told = {name: vars(base)[name] for base in reversed(cls.__mro__) for name in forms if name in vars(base)}
        cls.meanings = {name: told[name] for name in forms if isinstance(told.get(name), Meaning)}


def _in_lines(dtype: np.dtype[np.void]) -> np.dtype[np.void]:
    """Return a dtype with room after its fields, so that records begin where a line of the cache does."""
    fields: Mapping[str, Any] = dtype.fields or {}
    lines = -(-dtype.itemsize // LINE) | 1
    return np.dtype(
        {
            "names": list(fields),
            "formats": [form[0] for form in fields.values()],
            "offsets": [form[1] for form in fields.values()],
            "itemsize": lines * LINE,
        },
        align=True,
    )


def _names(cls: type) -> tuple[str, ...]:
    """Return the fields of a record class, none of the base of all."""
    dtype = getattr(cls, "dtype", None)
    return () if dtype is None else dtype.names or ()


def _form(cls: type[Record], name: str, hint: Any) -> Any:
    """Return a field as NumPy takes it: a dtype, or (dtype, shape)."""
    if isinstance(hint, type) and hasattr(hint, "dtype"):
        return hint.dtype
    if get_origin(hint) is Annotated:
        base, first, *shape = get_args(hint)
        of_records = get_origin(base) is list
        sizes = [first, *shape] if of_records else shape
        unknown = [size for size in sizes if isinstance(size, str) and size not in cls._lengths]
        if unknown:
            raise TypeError(f"{cls.__module__}.{cls.__qualname__}.{name}: lengths say no {', '.join(unknown)}")
        form = tuple(cls._lengths[size] if isinstance(size, str) else size for size in sizes)
        if of_records:
            return get_args(base)[0].dtype, form
        return (first, form) if form else first
    raise TypeError(f"{cls.__module__}.{cls.__qualname__}.{name}: {hint!r} is no field of a record")


def labels(cls: type[Record]) -> tuple[str, ...]:
    """Return what people read of each number of a record of numbers: ``"speed [rpm]"``; arrays count from 1."""
    found = []
    for name in cls.dtype.names or ():
        meaning = cls.meanings.get(name, Meaning("", ""))
        text = meaning.text or name.replace("_", " ")
        unit = f" [{meaning.unit}]" if meaning.unit else ""
        shape = cls.dtype[name].shape
        counted = [f" {k}" for k in range(1, int(np.prod(shape)) + 1)] if shape else [""]
        found += [f"{text}{number}{unit}" for number in counted]
    return tuple(found)


def record(**fields: Any) -> np.dtype[np.void]:
    """Return an aligned record dtype; a field is a dtype, ``(dtype, length)`` or ``(dtype, shape)``.

    Raises:
        ValueError: a field has the name of an attribute that records of NumPy have: plain Python would not reach it.
    """
    taken = [name for name in fields if hasattr(np.record, name)]
    if taken:
        raise ValueError(f"records of NumPy have {', '.join(taken)} already")
    parts = [
        (name, _plain(form[0]), form[1] if isinstance(form[1], tuple) else (form[1],))
        if isinstance(form, tuple)
        else (name, _plain(form))
        for name, form in fields.items()
    ]
    return cast("np.dtype[np.void]", np.dtype(cast(Any, parts), align=True))


def _plain(form: Any) -> Any:
    return get_args(form)[1] if get_origin(form) is Annotated else form


def zeros(count: int, dtype: Any) -> Any:
    """Return zeroed records, shape (count,), whose fields are attributes, compiled or not.

    Args:
        count: how many.
        dtype: a class of records, or a dtype.
    """
    return np.zeros(count, dtype).view(np.recarray)


def record_at(address: int, dtype: np.dtype[np.void]) -> Any:
    """Return the record that lies at an address, as a view (not compiled code)."""
    raw = (ctypes.c_char * dtype.itemsize).from_address(address)
    return np.frombuffer(cast(Any, raw), dtype).view(np.recarray)[0]
