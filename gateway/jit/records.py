"""Record dtypes of kernels, and records at an address."""

from __future__ import annotations

import ctypes
from typing import Any, cast

import numpy as np

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


def record_at(address: int, dtype: np.dtype[np.void]) -> Any:
    """Return the record that lies at an address, as a view (not compiled code)."""
    raw = (ctypes.c_char * dtype.itemsize).from_address(address)
    return np.frombuffer(cast(Any, raw), dtype).view(np.recarray)[0]
