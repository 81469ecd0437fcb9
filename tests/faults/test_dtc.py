"""DTC text and bytes; udsoncan and SAE J2012 agree on the base codes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.faults.dtc import Dtc, in_group
from gateway_fdi.errors import InputError


@given(st.integers(0, 0xFFFFFF))
def test_text_and_bytes_round_trip(value):
    dtc = Dtc(value)
    assert Dtc.parse(str(dtc)) == dtc
    assert Dtc.from_bytes(bytes(dtc)) == dtc


@pytest.mark.parametrize(
    ("text", "data"),
    [
        ("P0336-39", "033639"),
        ("P0336", "033600"),
        ("C0035-1F", "40351f"),
        ("B3FFF-FF", "bfffff"),
        ("U0100-87", "c10087"),
        ("p3abc-0d", "3abc0d"),
    ],
)
def test_known_codes(text, data):
    assert bytes(Dtc.parse(text)).hex() == data


@pytest.mark.parametrize("text", ["", "P", "P4000-00", "X0000-00", "P033", "P03361-29", "P0336-2", "P0336_29"])
def test_wrong_text_says_the_rule(text):
    with pytest.raises(InputError, match="a letter P, C, B or U"):
        Dtc.parse(text)


@pytest.mark.parametrize(
    ("text", "groups"),
    [
        ("P0336-39", {0xFFFFFF, 0xFFFF33}),
        ("C0001-00", {0xFFFFFF, 0xFFFF33, 0x400000}),
        ("C3FFF-FF", {0xFFFFFF, 0xFFFF33, 0x400000}),
        ("B3000-11", {0xFFFFFF, 0xFFFF33, 0x800000}),
        ("U0100-87", {0xFFFFFF, 0xFFFF33, 0xC00000}),
    ],
)
def test_groups(text, groups):
    value = Dtc.parse(text).value
    known = (0xFFFFFF, 0xFFFF33, 0x400000, 0x800000, 0xC00000, 0x000000, 0xFFFFFE)
    assert {g for g in known if in_group(value, g, emission_related=True)} == groups
    assert in_group(value, value, emission_related=False)
    assert not in_group(value, 0xFFFF33, emission_related=False)
    assert not in_group(value, value ^ 1, emission_related=True)
