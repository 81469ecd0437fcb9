"""The signed residual of a relation: its derivatives beside differences, and what has none."""

import math

import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.monitors.contract import LastResult
from gateway_checks.rule.params import PartParams, Rule
from gateway_checks.rule.residual import BENT, LINEAR, blames, residual_of
from gateway_checks.rule.text import compile_text


def part(holds, tolerance=3.0, when=None):
    programs = [compile_text(text, lambda _: None) for text in (holds, *([when] if when else []))]
    signals = tuple(dict.fromkeys(name for one in programs for name in one.signals))
    rule = Rule(name="r", holds=holds, tolerance=tolerance, when=when)
    return PartParams(
        rule=rule, code="U1000", holds=programs[0], when=programs[1] if when else None, signals=signals,
        units=("",) * len(signals),
    )  # fmt: skip


def read(holds, values, value=0.0, limit=3.0, square=0.0, held=0, **more):
    reader = residual_of(part(holds, **more))
    if reader is None:
        return None
    evidence, state = [*values, *[0.0] * (8 - len(values))], {"square": square, "held": held}
    return reader(LastResult(evidence, value, limit, state))


def gains(reading):
    return {one.part: one.gain for one in reading.gains}


NUMBERS = st.floats(0.5, 9.0)


@settings(max_examples=examples(200), deadline=None)
@given(st.tuples(NUMBERS, NUMBERS, NUMBERS))
def test_derivatives_are_those_of_small_differences(values):
    text = "A.x * B.y - sqrt(C.z) == 2 * A.x / C.z + exp(B.y / 5) ** 2 - sin(C.z)"

    def side(x, y, z):
        return x * y - math.sqrt(z) - (2 * x / z + math.exp(y / 5) ** 2 - math.sin(z))

    found = gains(read(text, values))
    for k, name in enumerate(("A.x", "B.y", "C.z")):
        step = 1e-6
        up, down = ([v + s * step * (j == k) for j, v in enumerate(values)] for s in (1, -1))
        slope = (side(*up) - side(*down)) / (2 * step)
        assert found.get(name, 0.0) == pytest.approx(slope, rel=1e-4, abs=1e-6)


def test_an_equation_has_what_is_left_of_it():
    reading = read("A.x == 0.5 * (B.y + B.z)", [10.0, 60.0, 40.0], 40.0)
    assert reading.residual == -40.0  # the distance, with its sign
    assert reading.noise == pytest.approx(1.0)  # a third of the tolerance
    assert gains(reading) == {"A.x": 1.0, "B.y": -0.5, "B.z": -0.5}
    assert reading.gain_error == LINEAR
    assert reading.beyond == pytest.approx(40.0 / 3.0)


def test_a_limit_of_a_difference_has_the_difference_with_its_sign():
    text = "abs(A.x - A.y) < 3 + 0.1 * B.v"
    reading = read(text, [10.0, 50.0, 60.0], 40.0, 9.0)
    assert reading.residual == -40.0
    assert reading.noise == pytest.approx(3.0)
    assert gains(reading) == {"A.x": 1.0, "A.y": -1.0}  # how far they may be apart is no part of it
    shares = {one.part: one.share for one in blames(part(text))["r"]}
    assert shares["B.v"] < 0.01 * shares["A.x"]
    assert shares["r"] == 1.0


def test_what_a_delay_remembers_has_no_sign_once_its_signal_has_come_back():
    """The speed was 40 too high and is right again; what was delayed is still off by 40, below what it is now."""
    text = "abs(A.ui - 1.001 * delay(B.v, 250)) <= 2"
    reading = read(text, [70.0, 110.0], 40.1)
    assert reading.residual == -40.1
    assert read(text, [70.0, 69.8], 40.1) is None


@pytest.mark.parametrize(
    "holds",
    ["A.x < 3", "A.x > 3 and A.y > 2", "A.x != A.y", "not A.x == A.y", "abs(lowpass(A.x, 100)) < 2 and A.y > 1"],
)
def test_of_other_relations_nothing_is_known_of_sizes(holds):
    assert read(holds, [1.0, 2.0]) is None


def test_what_no_small_error_can_stand_for_has_no_gain():
    assert gains(read("max(A.x, A.y) + B.z == 5", [1.0, 2.0, 3.0])) == {"B.z": 1.0}
    assert gains(read("rate(A.x) == B.z", [1.0, 2.0])) == {"B.z": -1.0}
    assert gains(read("lowpass(A.x, 100) == B.z", [1.0, 2.0])) == {"A.x": 1.0, "B.z": -1.0}
    assert read("A.x * A.y == 5", [1.0, 2.0]).gain_error == BENT


def test_a_tolerance_of_nothing_says_nothing_of_noise():
    assert read("A.x == A.y", [1.0, 2.0], 1.0, 0.0, tolerance=0.0) is None


def test_the_noise_is_what_it_was_off_lately_while_it_held():
    def noise(**lately):
        return read("A.x == B.y", [9.0, 2.0], 7.0, limit=6.0, **lately).noise

    assert noise(square=0.25, held=99) == 2.0  # not known yet
    assert noise(square=0.25, held=100) == pytest.approx(1.5)
    assert noise(square=4.0, held=1000) == 2.0
    assert noise(square=1e-9, held=1000) == pytest.approx(0.2)
