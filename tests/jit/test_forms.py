"""Arguments and results of kernels, through the cells that carry them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jit_kernels import PAIR, Both, several, sum_of, touch

from gateway_fdi.errors import KernelError
from gateway_fdi.jit import COMPILED, kernel
from gateway_fdi.jit.forms import (
    Arr,
    code_of,
    form_of,
    parse_results,
    take,
    text_of,
)

INT64 = st.integers(-(2**63), 2**63 - 1)
compiled = pytest.mark.skipif(not COMPILED, reason="not COMPILED: there are no cells")


@given(INT64, st.floats(width=64), st.booleans())
def test_numbers_go_in_and_come_out_bit_for_bit(whole, real, flag):
    back = several(whole, real, flag)
    assert back[0] == whole
    assert np.float64(back[1][0]).tobytes() == np.float64(real).tobytes()
    assert back[1][1] is flag


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30), st.integers(1, 3))
def test_arrays_are_seen_with_their_strides(values, every):
    whole = np.repeat(np.asarray(values), every)
    seen = whole[::every]
    assert sum_of(seen) == pytest.approx(float(seen.sum()), rel=1e-12, abs=1e-6)


def test_a_record_is_changed_in_place_also_in_a_tuple():
    record = np.zeros(2, PAIR).view(np.recarray)
    touch(Both(record, np.arange(3.0)), 2)
    assert record[1].whole == 2
    assert record[1].ratio == 2.0


def test_the_same_kernel_takes_an_array_that_cannot_be_written():
    fixed = np.arange(4.0)
    fixed.flags.writeable = False
    assert sum_of(fixed) == 6.0


@compiled
def test_writing_into_an_array_that_cannot_be_written_is_refused():
    @kernel
    def spoil(values):
        values[0] = 1.0

    fixed = np.zeros(2)
    fixed.flags.writeable = False
    with pytest.raises(KernelError, match="spoil"):
        spoil(fixed)
    assert fixed[0] == 0.0


@compiled
def test_what_no_kernel_takes_is_an_error_that_says_so():
    with pytest.raises(TypeError, match="dict"):
        sum_of({})


@compiled
def test_a_result_that_is_no_number_is_refused():
    @kernel
    def half(values):
        return values[:1]

    with pytest.raises(KernelError, match=r"half.*cannot be compiled"):
        half(np.zeros(2))


@compiled
def test_a_kernel_that_allocates_is_refused():
    @kernel
    def made(count):
        return np.zeros(count)[0]

    with pytest.raises(KernelError, match="made"):
        made(3)


def test_texts_of_results_are_read_back():
    form = form_of((1, 2.0, (True, None)))
    assert parse_results(text_of(form)) == form
    assert len(code_of(form)) == 3
    assert take(form, (5, 1.5, 1))[0] == (5, 1.5, (True, None))


def test_the_order_of_an_array_is_part_of_its_form():
    square = np.zeros((3, 3))
    assert form_of(square) == Arr(square.dtype, 2, True, True)
    assert form_of(square.T) == Arr(square.dtype, 2, False, True)
