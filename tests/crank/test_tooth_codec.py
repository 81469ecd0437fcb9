"""Tooth codes against their error bounds."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gateway_plants.crank.tooth_codec import (
    LONGEST_LONG_US,
    LONGEST_US,
    OVERFLOW_CODE,
    PADDING_CODE,
    code_of,
    encode_intervals,
    period_us,
)


def test_every_code_keeps_its_value():
    for code in range(4096):
        if code in (PADDING_CODE, OVERFLOW_CODE) or code & 0x3FF == 0:
            continue
        assert period_us(code_of(period_us(code))) == period_us(code)


@given(st.floats(1, LONGEST_US))
def test_a_code_is_near_its_interval(interval):
    code = code_of(interval)
    assert code not in (PADDING_CODE, OVERFLOW_CODE)
    assert abs(period_us(code) - interval) <= max(0.5, 0.002 * interval + 1e-9)


def test_too_long_an_interval_is_said_to_be_so():
    assert code_of(LONGEST_LONG_US * 1.02) == OVERFLOW_CODE


@given(st.floats(LONGEST_US + 64, LONGEST_LONG_US))
def test_a_long_interval_has_a_long_code(interval):
    code = code_of(interval)
    assert 0xC00 <= code < 0xD00
    assert abs(period_us(code) - interval) <= 0.016 * interval


def test_an_ordinary_interval_behind_a_long_one_keeps_its_value():
    """What the long code is off is not taken from it."""
    codes = np.zeros(3, np.int64)
    encode_intervals(np.cumsum([0.0, 1250.0, 453_750.0, 1250.0]), codes)
    assert [period_us(int(code)) for code in codes[::2]] == [1248.0, 1248.0]


@given(st.lists(st.floats(20, 60000), min_size=1, max_size=200))
def test_rounding_does_not_add_up(intervals):
    times = np.concatenate([[0.0], np.cumsum(intervals)])
    codes = np.zeros(len(intervals), np.int64)
    encode_intervals(times, codes)
    decoded = np.cumsum([period_us(int(c)) for c in codes])
    assert np.abs(decoded - times[1:]).max() <= 32.5
