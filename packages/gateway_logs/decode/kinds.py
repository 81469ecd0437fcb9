"""Kinds of the columns that signals become: numbers as the database has them, names where it names all values.

A floating-point signal, and one whose scale or offset is no whole number, is float64. One that is whole is int64, or
uint64 where only that holds all its values; the few that neither holds are float64. A signal whose database names all
values that it may have is a dictionary of these names; a value without a name is its number as text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gateway.signals.bits import field_of
from gateway.signals.payloads import bits_of

if TYPE_CHECKING:
    import pyarrow as pa
    from cantools.database.can.signal import Signal

#: Whole numbers up to here are exact in a float64.
_EXACT = 2**53
#: Signals longer than this have no table of names [bit].
_NAMED = 16

FLOAT, INTEGER, UNSIGNED, NAMES = "float64", "int64", "uint64", "names"


def _whole(value: Any) -> bool:
    return float(value).is_integer()


def _raw_range(signal: Signal) -> tuple[int, int]:
    """Return the least and greatest number that a signal's bits carry."""
    if signal.is_signed:
        return -(1 << signal.length - 1), (1 << signal.length - 1) - 1
    return 0, (1 << signal.length) - 1


def _all_named(signal: Signal) -> bool:
    """Return whether a database names all values that a signal may have: then they are no measures."""
    if not signal.choices or signal.is_float or signal.length > _NAMED or signal.scale != 1 or signal.offset != 0:
        return False
    low, high = _raw_range(signal)
    bounded = signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum
    if bounded:
        low, high = max(low, int(signal.minimum or 0)), min(high, int(signal.maximum or 0))
    named = {int(value) for value in signal.choices}
    if all(value in named for value in range(low, high + 1)):
        return True
    return signal.length > 1 and 2 * len(named) >= 1 << signal.length


@dataclass(frozen=True)
class Kind:
    """Kind of a signal's column.

    Attributes:
        signal: of the database.
        what: FLOAT, INTEGER, UNSIGNED or NAMES.
        exact: whether a float64 carries all its values exactly.
    """

    signal: Signal
    what: str
    exact: bool


def kind_of(signal: Signal, *, numbers: bool = False) -> Kind:
    """Return what column a signal of at most 64 bits becomes; ``numbers``: names are not taken."""
    if signal.is_float or not (_whole(signal.scale) and _whole(signal.offset)):
        return Kind(signal, FLOAT, exact=True)
    if not numbers and _all_named(signal):
        return Kind(signal, NAMES, exact=True)
    scale, offset = int(signal.scale), int(signal.offset)
    ends = [raw * scale + offset for raw in _raw_range(signal)]
    low, high = min(ends), max(ends)
    exact = low >= -_EXACT and high <= _EXACT
    if low >= -(2**63) and high < 2**63:
        return Kind(signal, INTEGER, exact)
    if low >= 0 and high < 2**64 and scale > 0:
        return Kind(signal, UNSIGNED, exact)
    return Kind(signal, FLOAT, exact)


def common_kind(signal: Signal, kinds: Sequence[Kind]) -> Kind:
    """Return what column several signals of one name, for which ``signal`` stands, become together."""
    named = {(kind.what, kind.signal.length, kind.signal.is_signed, str(kind.signal.choices)) for kind in kinds}
    if len(named) == 1 and kinds[0].what == NAMES:
        return kinds[0]
    whole = all(kind.what != FLOAT and kind.exact for kind in kinds)
    return Kind(signal, INTEGER if whole else FLOAT, exact=True)


def _exactly(kind: Kind, words: NDArray[np.uint64]) -> NDArray[Any]:
    """Return whole values that a float64 would round."""
    signal = kind.signal
    bits = bits_of(words, field_of(signal))
    with np.errstate(over="ignore"):  # wraps within the type, in which the result lies
        if kind.what == UNSIGNED:
            return bits * np.uint64(int(signal.scale)) + np.int64(int(signal.offset)).astype(np.uint64)
        unused = np.uint64(64 - signal.length)
        raw = (bits << unused).view(np.int64) >> np.int64(unused) if signal.is_signed else bits.view(np.int64)
        return raw * np.int64(int(signal.scale)) + np.int64(int(signal.offset))


def _names(signal: Signal, values: NDArray[np.float64], there: NDArray[np.bool_]) -> pa.Array:
    """Return a dictionary of names."""
    import pyarrow as pa  # noqa: PLC0415 - an extra

    low, high = _raw_range(signal)
    choices = dict(signal.choices or {}).items()
    known = {int(value): str(name) for value, name in choices if low <= int(value) <= high}
    raw = np.where(there, values, low).astype(np.int64) - low
    table = np.full(high - low + 1, -1, np.int32)
    names = list(dict.fromkeys(known.values()))
    place = {name: k for k, name in enumerate(names)}
    for value, name in known.items():
        table[value - low] = place[name]
    for value in np.unique(raw[there & (table[raw] < 0)]).tolist():
        table[value] = len(names)
        names.append(str(value + low))
    return pa.DictionaryArray.from_arrays(pa.array(table[raw], mask=~there), pa.array(names or [""], pa.string()))


def column(kind: Kind, values: NDArray[np.float64], there: NDArray[np.bool_], words: NDArray[np.uint64]) -> pa.Array:
    """Return a column of values, shape (frames,), null where it is not there, of payloads, shape (frames, 8)."""
    import pyarrow as pa  # noqa: PLC0415 - an extra

    if kind.what == NAMES:
        return _names(kind.signal, values, there)
    mask = None if there.all() else ~there
    if kind.what == FLOAT:
        return pa.array(values, mask=mask, from_pandas=False)
    if not kind.exact:
        return pa.array(_exactly(kind, words), mask=mask)
    return pa.array(np.where(there, values, 0.0).astype(kind.what), mask=mask)


def arrow_type(kind: Kind) -> pa.DataType:
    """Return the type of a signal's column."""
    import pyarrow as pa  # noqa: PLC0415 - an extra

    if kind.what == NAMES:
        return pa.dictionary(pa.int32(), pa.string())
    return {FLOAT: pa.float64(), INTEGER: pa.int64(), UNSIGNED: pa.uint64()}[kind.what]
