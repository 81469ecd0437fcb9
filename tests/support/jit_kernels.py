"""Small kernels for the tests of gateway_fdi.jit."""

from typing import Any, NamedTuple

from gateway_fdi.jit import f8, i8, kernel, record

PAIR = record(whole=i8, ratio=f8)


class Both(NamedTuple):
    """Two arrays in one argument."""

    records: Any
    values: Any


@kernel
def several(whole, real, flag):
    """Return what was given, in a tuple of tuples."""
    return whole, (real, flag)


@kernel
def sum_of(values):
    """Return the sum."""
    total = 0.0
    for k in range(values.shape[0]):
        total += values[k]
    return total


@kernel
def _write(r, value):
    r.whole = int(value)
    r.ratio = value


@kernel
def touch(both, place):
    """Write a value into the second record."""
    _write(both.records[1], both.values[place])


@kernel
def at(values, place):
    """Return an item."""
    return values[place]
