"""How values become bytes: data identifiers, PIDs of OBD, parameters of J1939 freeze frames."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.servers.identifiers import DidParams
from gateway_testers.j1939.params import FreezeFrameSpn
from gateway_testers.obd.params import STANDARD, PidParams

CODES = {
    "u8": "B",
    "u16": "H",
    "u32": "I",
    "i8": "b",
    "i16": "h",
    "i32": "i",
    "f32": "f",
    "f64": "d",
}


@given(
    st.sampled_from([code for code in CODES if code[0] != "f"]),
    st.floats(-1e12, 1e12),
    st.sampled_from([0.001, 0.5, 1.0, -2.0, 40.0]),
    st.sampled_from([0.0, -40.0, 1e6]),
)
def test_an_integer_is_the_nearest_step_or_the_nearest_end(kind, value, scale, offset):
    did = DidParams(id=0x1234, name="x", signal="M.S", type=kind, scale=scale, offset=offset)
    data = did.encode(value)
    (coded,) = struct.unpack(">" + CODES[kind], data)
    bits = 8 * len(data)
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if kind[0] == "i" else (0, (1 << bits) - 1)
    wanted = (value - offset) / scale
    if wanted <= low:
        assert coded == low
    elif wanted >= high:
        assert coded == high
    else:
        assert abs(coded - wanted) <= 0.5


@pytest.mark.parametrize("kind", CODES)
def test_what_is_not_known_is_said_to_be_so(kind):
    did = DidParams(id=0x1234, name="x", signal="M.S", type=kind)
    for unknown in (None, math.nan, math.inf):
        data = did.encode(unknown)
        if kind[0] == "f":
            assert math.isnan(struct.unpack(">" + CODES[kind], data)[0])
        else:
            assert set(data) == {0xFF}


def test_floats_are_floats():
    did = DidParams(id=0x1234, name="x", signal="M.S", scale=0.5, offset=1.0)
    assert struct.unpack(">f", did.encode(3.0)) == (4.0,)
    assert struct.unpack(">f", did.encode(1e300)) == (math.inf,)
    assert struct.unpack(">f", did.encode(-1e300)) == (-math.inf,)


@given(st.sampled_from(sorted(STANDARD)), st.floats(-1e6, 1e6))
def test_pids_are_the_nearest_step_or_the_nearest_end(pid, value):
    length, scale, offset = STANDARD[pid]
    data = PidParams(id=pid, signal="M.S").encode(value)
    assert len(data) == length
    wanted = min(max((value - offset) / scale, 0), 256**length - 1)
    assert abs(int.from_bytes(data, "big") - wanted) <= 0.5


@pytest.mark.evidence("SAE J1939-73: parameters")
@given(st.integers(1, 4), st.floats(-1e12, 1e12))
def test_j1939_parameters_stay_in_the_valid_range(length, value):
    """Above 0xFA.. are error codes and "not available" (J1939-71, 5.1.3)."""
    data = FreezeFrameSpn(spn=190, signal="M.S", length=length, scale=0.125).encode(value)
    coded = int.from_bytes(data, "little")
    most = int("FA" + "FF" * (length - 1), 16)
    assert abs(coded - min(max(value / 0.125, 0), most)) <= 0.5
    assert FreezeFrameSpn(spn=190, signal="M.S", length=length).encode(None) == b"\xff" * length
