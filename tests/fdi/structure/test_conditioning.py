"""Whether states forget where they began, and whether they have a beginning, beside poles worked out by hand."""

from dataclasses import replace

import pytest

from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.generator.conditioning import begins, forgets, gains_at_rest, noise_gains
from gateway_fdi.structure.generator.initial import find_initial
from gateway_fdi.structure.generator.realisation import realise
from gateway_fdi.structure.model import Quantity

#: x'' = u - d x' - k x, y = x, through a table that is the identity.
SPRING = """
[unknown]
x = {{ start = 0.0 }}
v = {{ start = 0.0 }}
[known]
u = {{}}
y = {{}}
[parameter]
k = {{ value = {k} }}
d = {{ value = {d} }}
[table.f]
x = [-10, 10]
y = [-10, 10]
[equation.e1]
relation = "der(x) = v"
unique = ["der(x)"]
[equation.e2]
relation = "der(v) = u - k * f(x) - d * v"
unique = ["der(v)"]
[equation.e3]
relation = "y = x"
unique = ["x"]
"""


@pytest.mark.parametrize(
    ("k", "d", "stable"),
    [(4.0, 0.5, True), (4.0, 0.0, False), (0.0, 0.5, False), (4.0, -0.1, False), (-1.0, 0.5, False)],
)
def test_a_spring_forgets_if_it_is_damped(tmp_path, k, d, stable):
    """Its poles are the roots of s^2 + d s + k."""
    (tmp_path / "spring.toml").write_text(SPRING.format(k=k, d=d))
    model = load_model(tmp_path / "spring.toml")
    realised = realise(model, frozenset(["e1", "e2", "e3"]), "e3")
    assert forgets(realised, ("x", "v")) == stable
    assert forgets(realised, ())


def test_two_tanks_forget_all_but_what_is_in_them_together(load):
    """p1' = q0 - (p1 - p2), p2' = (p1 - p2) - q2: their sum stays, though each derivative depends on both."""
    model = load("three_tanks")
    realised = realise(model, frozenset(["e1", "e4", "e5", "e7", "e8", "e9", "e10", "e11"]), "e7")
    assert set(realised.integrated) == {"p1", "p2"}
    assert not forgets(realised, ("p1", "p2"))


def test_a_beginning_that_divides_by_zero(load):
    """r = 0 and r' = 0 determine p2 and p3 unless the tanks are alike: then r' has their difference only, as r has."""
    model, members = load("three_tanks"), frozenset(["e1", "e2", "e3", "e5", "e6", "e7", "e8", "e11", "e12"])
    other = replace(model, quantities={**model.quantities, "CT3": Quantity(value=2.0), "Rv3": Quantity(value=3.0)})
    for one, there in ((model, False), (other, True)):
        realised = realise(one, members, "e2")
        assert begins(realised, find_initial(realised)) == there


#: A shaft between two masses, as stiff as that of a wind turbine: at rest its ends turn alike, whatever the torque.
SHAFT = """
[unknown]
a = {}
b = {}
twist = {}
[known]
u = {}
y = {}
z = {}
[fault]
f_u = {}
f_y = {}
[parameter]
K = { value = 2.7e9 }
N = { value = 95.0 }
[equation.e1]
relation = "der(twist) = a - b / N"
unique = ["der(twist)"]
[equation.e2]
relation = "390 * der(b) = K * twist / N + 700 * (a - b / N) - 45 * b - u * (1 + f_u)"
unique = ["der(b)"]
[equation.e3]
relation = "y = a + f_y"
unique = ["a"]
[equation.e4]
relation = "z = b"
unique = ["b"]
"""


def test_what_is_left_at_rest_is_no_rounding(tmp_path):
    (tmp_path / "shaft.toml").write_text(SHAFT)
    model = load_model(tmp_path / "shaft.toml")
    found = gains_at_rest(realise(model, frozenset({"e1", "e2", "e3", "e4"}), "e4", start={"twist": 0.0, "b": 0.0}))
    assert found == {"f_u": 0.0, "f_y": pytest.approx(95.0)}


#: y1 = 2 x, y2 = 3 x, y3 = 5 x'.
RATES = """
[unknown]
x = {}
v = {}
[known]
y1 = {}
y2 = {}
y3 = {}
[equation.e1]
relation = "y1 = 2 * x"
unique = ["x"]
[equation.e2]
relation = "y2 = 3 * x"
[equation.e3]
relation = "der(x) = v"
unique = ["v", "der(x)"]
[equation.e4]
relation = "y3 = 5 * v"
"""


def test_noise_reaches_a_residual_by_values_and_by_rates(tmp_path):
    """y2 - 1.5 y1, and y3 - 2.5 y1'; the residual's own sign and scale are taken out."""
    (tmp_path / "rates.toml").write_text(RATES)
    model = load_model(tmp_path / "rates.toml")
    static = {z: found for z, *found in noise_gains(realise(model, frozenset(["e1", "e2"]), "e2"))}
    assert set(static) == {"y1", "y2"}
    assert static["y1"] == pytest.approx([-1.5 * static["y2"][0], 0.0], abs=1e-6)
    assert static["y2"][1] == 0.0
    rates = realise(model, frozenset(["e1", "e3", "e4"]), "e4", differentiate=True)
    moving = {z: found for z, *found in noise_gains(rates)}
    assert set(moving) == {"y1", "y3"}
    assert moving["y1"] == pytest.approx([0.0, -2.5 * moving["y3"][0]], abs=1e-6)
