"""Kernels whose leading arguments are bound: the same as calling them, with less to do for each call."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway_fdi.jit import COMPILED, Same, bound, intrinsics, kernel, kernels

PAIR = np.dtype([("low", "<u4"), ("high", "<u4")])
NONE = np.zeros(0, PAIR)


@kernel
def weighed(factors, pairs, words, first, more):
    """Sum pairs from ``first`` on, seen as records and as words."""
    records, total = 0, 0
    for k in range(first, pairs.shape[0]):
        records += int(pairs[k]["low"]) * factors[0] + int(pairs[k]["high"])
        total += int(words[k, 0] >> np.uint64(32))
    return records, total + more


@kernel
def length_of(pairs, words):
    return pairs.shape[0] + words.shape[0]


@given(st.lists(st.tuples(st.integers(0, 2**20), st.integers(0, 2**20)), max_size=9), st.integers(0, 9))
def test_a_bound_kernel_gives_what_the_kernel_gives(values, first):
    factors = np.array([3], np.int64)
    call = bound(weighed, factors, rest=(NONE, Same(0, NONE.view("<u8").reshape(0, 1)), 0, 0))
    pairs = np.array(values, PAIR)
    for factor, more in ((3, 5), (7, -2)):
        factors[0] = factor
        words = pairs.view("<u8").reshape(len(pairs), 1)
        found = call(pairs, first, more)
        assert tuple(map(int, found)) == tuple(map(int, weighed(factors, pairs, words, first, more)))
        assert int(found[0]) == sum(low * factor + high for low, high in values[first:])
        assert int(found[1]) == sum(high for _, high in values[first:]) + more


def test_arrays_may_be_of_another_length_at_each_call():
    call = bound(length_of, rest=(NONE, Same(0, NONE)))
    assert [call(np.zeros(n, PAIR)) for n in (0, 5, 2)] == [0, 10, 4]


@pytest.mark.skipif(not COMPILED, reason="plain Python takes what it gets")
def test_what_is_no_array_in_one_piece_and_no_integer_is_refused():
    with pytest.raises(TypeError, match="integers, and arrays"):
        bound(weighed, np.zeros(1, np.int64), NONE, NONE.view("<u8").reshape(0, 1), 0, rest=(0.5,))
    with pytest.raises(TypeError, match="2 arguments, not 1"):
        bound(weighed, np.zeros(1, np.int64), NONE, NONE.view("<u8").reshape(0, 1), rest=(0, 0))(1)


def test_entries_of_plain_python_are_called_by_their_numbers(monkeypatch):
    monkeypatch.setattr(kernels, "COMPILED", False)
    called = []
    records = [np.zeros(1, [("x", np.float64)]) for _ in range(4)]
    dtypes = tuple(each.dtype for each in records)
    numbers = [kernels.entry_point(lambda *given, k=k: called.append((k, given)), dtypes) for k in (0, 1)]
    for number in reversed(numbers):
        assert intrinsics._call_entry(number, *(each.ctypes.data for each in records)) == 0
    assert [k for k, _ in called] == [1, 0]
    called[0][1][3]["x"] = 7.0
    assert records[3]["x"] == 7.0, "the records are those at the addresses"
