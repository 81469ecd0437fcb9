"""What monitors send is what cantools would send."""

import cantools.database.can as can_database
import numpy as np
import pytest
from amount import examples
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.signals.columns import insert
from gateway.signals.decode import SIGNAL
from gateway.signals.tables import encode_rows
from gateway_fdi.errors import InputError
from gateway_fdi.jit import COMPILED


@st.composite
def layouts(draw):
    """A message of integer signals side by side, all of one byte order."""
    size = draw(st.sampled_from([1, 3, 8, 8, 12, 64]))
    order = draw(st.sampled_from(["little_endian", "big_endian"]))
    signals, at = [], 0
    while at < 8 * size and len(signals) < 12:
        at += draw(st.integers(0, 9))
        length = draw(st.integers(1, 64))
        if at + length > 8 * size:
            break
        start = at if order == "little_endian" else 8 * (at // 8) + 7 - at % 8
        scale = draw(st.sampled_from([1, 0.5, 0.1, 4, -2.5]))
        signals.append(
            Signal(
                f"S{len(signals)}",
                start,
                length,
                byte_order=order,
                is_signed=draw(st.booleans()),
                conversion=BaseConversion.factory(scale, draw(st.sampled_from([0, -40]))),
            )
        )
        at += length
    return can_database.Message(0x123, "M", size, signals, strict=True)


def encoded(message, values):
    rows = np.asarray(encode_rows(message, list(values)), SIGNAL)
    rows = rows if COMPILED else rows.view(np.recarray)
    words = np.zeros(8, np.uint64)
    for row, value in zip(rows, values.values(), strict=True):
        insert(words, row, float(value))
    return words.tobytes()[: message.length]


@pytest.mark.evidence("Live is replay: encode")
@settings(max_examples=examples(300))
@given(layouts(), st.data())
def test_encoding_is_cantools(message, data):
    """Any raw value of up to 53 bits (float64 carries no more), any layout, both byte orders."""
    raws, values = {}, {}
    for s in message.signals:
        bits = min(s.length, 53)
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if s.is_signed else (0, (1 << bits) - 1)
        raws[s.name] = data.draw(st.integers(low, high), label=s.name)
        values[s.name] = raws[s.name] * s.scale + s.offset
        if round((values[s.name] - s.offset) / s.scale) != raws[s.name]:
            raws[s.name] = 0
            values[s.name] = s.offset
    expected = message.encode(raws, scaling=False, strict=False) if raws else b"\0" * message.length
    assert encoded(message, values) == bytes(expected)


@pytest.mark.parametrize("signed", [False, True])
def test_values_out_of_range_become_the_nearest(signed):
    signal = Signal("S", 3, 12, is_signed=signed, conversion=BaseConversion.factory(0.5, 10))
    message = can_database.Message(1, "M", 8, [signal])
    low, high = (-2048, 2047) if signed else (0, 4095)
    for value, raw in ((1e9, high), (-1e9, low), (np.inf, high), (-np.inf, low), (np.nan, 0)):
        assert message.decode(encoded(message, {"S": value}), scaling=False) == {"S": raw}


def test_what_cannot_be_sent_is_refused():
    floating = Signal("F", 0, 32, conversion=BaseConversion.factory(is_float=True))
    message = can_database.Message(1, "M", 8, [floating])
    with pytest.raises(InputError, match="integer of at most 64 bits"):
        encode_rows(message, ["F"])
    with pytest.raises(InputError, match="no signal 'G'"):
        encode_rows(message, ["G"])
