"""Generated residual generators against residuals derived by hand, on simulated data."""

import ast
import contextlib
import sys
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import truck_data
from amount import amount
from residual_runner import Runner, close
from scipy.linalg import expm

from gateway_fdi.jit import zeros
from gateway_fdi.structure.generator import budget
from gateway_fdi.structure.generator.code import write
from gateway_fdi.structure.generator.loading import load, residual_generator
from gateway_fdi.structure.generator.realisation import realise
from gateway_fdi.structure.generator.solver import NotSolvableError
from gateway_fdi.structure.model import Equation, Loop, Model, Quantity, Solvable, differential
from gateway_fdi.structure.relation import Relation

SECONDS = amount(60, 60, 5)


def of_truck(truck, name):
    choice = truck.residuals[name]
    return residual_generator(truck, choice.equations, choice.consistency, name=name)


@pytest.fixture(scope="module")
def rows():
    """Faulty and noisy, so that no residual is zero."""
    return truck_data.drive(SECONDS, 7, noise=0.3, f_R=-0.2, f_pe=-0.01, f_eta=-0.1)


def test_t1(truck, rows):
    close(Runner(of_truck(truck, "T1")).run(rows, truck_data.DT), truck_data.t1(rows))


def test_t2(truck, rows):
    close(Runner(of_truck(truck, "T2")).run(rows, truck_data.DT), truck_data.t2(rows))


@pytest.mark.parametrize("test", ["t5", "t6"])
def test_beyond_the_paper(truck, rows, test):
    found = Runner(of_truck(truck, test.upper())).run(rows, truck_data.DT)
    close(found, getattr(truck_data, test)(rows))


@pytest.mark.parametrize("test", ["T3_ICDS", "T4_ICDS", "T7"])
def test_integral_causality(truck, rows, test):
    found = Runner(of_truck(truck, test)).run(rows, truck_data.DT)
    expected = np.array(truck_data.integral(rows, test[:2]))
    assert np.abs(found - expected).max() < 3e-4
    assert np.abs(expected).max() > 1e-2


@pytest.mark.parametrize("test", ["T3", "T4"])
def test_mixed_causality(truck, rows, test):
    found = Runner(of_truck(truck, f"{test}_MCDS"), filter_bandwidth=0.5).run(rows, truck_data.DT)
    expected = np.array(truck_data.mixed(rows, test, 0.5))
    assert np.abs(found - expected).max() < 1e-5
    assert np.abs(expected).max() > 1e-2


def test_healthy_data_leave_nothing(truck):
    """The plant of the data is the model, by Euler's method at 10 ms: its error is left, over all gear changes."""
    rows = truck_data.drive(SECONDS, 1)
    for name in truck.residuals:
        found = Runner(of_truck(truck, name), filter_bandwidth=0.5).run(rows, truck_data.DT)
        assert np.abs(found).max() < 1e-3, name


def test_states_that_are_carried_keep_their_values(truck):
    """A start behind a pause: fuel and charge stay, the speed begins anew, and the pause is not integrated over."""
    rows = truck_data.drive(20, 2)
    runner = Runner(of_truck(truck, "T4_ICDS"))
    runner.run(rows[:900], truck_data.DT)
    before = {name: float(runner.s[0][name]) for name in ("SoC", "m_f")}
    assert before["SoC"] < 0.5
    assert before["m_f"] > 0
    runner.start(**rows[1500])
    assert runner.step(0.0, **rows[1500]) == 0.0
    assert {name: float(runner.s[0][name]) for name in ("SoC", "m_f")} == before
    runner.loaded.reset(runner.s[0], runner.c[0])
    assert runner.s[0]["SoC"] == 0.5


@pytest.mark.parametrize("test", ["T4_ICDS", "T4_MCDS"])
def test_dead_samples_do_not_poison_states(truck, test):
    """U_em_sens = 0 divides by zero in T4: the residual is no number once, and the states survive it."""
    rows = truck_data.drive(2, 3)
    runner = Runner(of_truck(truck, test))
    runner.run(rows[:50], truck_data.DT)
    with np.errstate(all="ignore"):
        dead = runner.step(0.01, **{**rows[50], "U_em_sens": 0.0, "I_b_sens": 0.0})
        after = runner.step(0.01, **rows[51])
    assert np.isnan(dead) == (test == "T4_MCDS")  # e32 does not see e11 but through the states
    assert all(np.isfinite(runner.s[0][name]).all() for name in runner.loaded.state.names)
    assert abs(after) < 0.02


# Initial states (24)
# ----------------------------------------------------------------------------------------------------


def spring(**quantities):
    """x'' = u - k x, y = x: two states, of which one is measured."""
    unique = Solvable.UNIQUE
    return Model(
        "spring",
        (
            Equation("e1", ("der(x)", "v"), solvable={"der(x)": unique}, relation=Relation.parse("der(x) = v")),
            Equation("e2", ("der(v)", "x"), ("u",), solvable={"der(v)": unique},
                relation=Relation.parse("der(v) = u - k * x")),
            Equation("e3", ("x",), ("y",), solvable={"x": unique}, relation=Relation.parse("y = x")),
        ),
        ("x", "v"),
        ("u", "y"),
        parameters=("k",),
        quantities={"k": Quantity(value=4.0), **quantities},
    )  # fmt: skip


def test_two_states_begin_where_residual_and_its_rate_are_zero():
    """r = y - x, r' = y' - v: v begins at the rate of y, which whoever starts the generator gives."""
    loaded = residual_generator(spring(), frozenset(["e1", "e2", "e3"]), "e3")
    assert loaded.generated.rates == ("y_rate1",)
    runner = Runner(loaded)
    runner.start(u=0.3, y=1.5, y_rate1=-0.7)
    assert (runner.s[0]["x"], runner.s[0]["v"]) == (1.5, -0.7)
    dt, x = 0.1, np.array([1.5, -0.7])
    turn = expm(dt * np.array([[0.0, 1.0, 0.0], [-4.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    for k in range(2000):
        u = 0.3 + 0.1 * np.sin(0.01 * k)
        assert abs(runner.step(dt if k else 0.0, u=u, y=x[0])) < 1e-9
        x = (turn @ [*x, u])[:2]


def test_what_24_cannot_give_needs_a_start_value(load):
    with pytest.raises(NotSolvableError, match=r"v: .*start value"):
        # x is given, and the residual does not depend on v at the first instant.
        write("r", realise(spring(x=Quantity(value=0.0)), frozenset(["e1", "e2", "e3"]), "e3"))
    both = realise(spring(), frozenset(["e1", "e2", "e3"]), "e3", start={"x": 1.0, "v": 2.0})
    runner = Runner(load_generated(both))
    assert (runner.s[0]["x"], runner.s[0]["v"]) == (1.0, 2.0)
    model = load("truck")
    bare = replace(model, quantities={k: Quantity() if k == "SoC" else q for k, q in model.quantities.items()})
    choice = model.residuals["T2"]
    with pytest.raises(NotSolvableError, match="SoC: .*start value"):
        write("T2", realise(bare, choice.equations, choice.consistency))
    with pytest.raises(NotSolvableError, match="m_f: .*by the state of \\(20\\) alone.*start value"):
        bare = replace(
            model,
            quantities={k: Quantity() if k == "m_f" else q for k, q in model.quantities.items()},
        )
        choice = model.residuals["T3_MCDS"]
        write("T3", realise(bare, choice.equations, choice.consistency))


def load_generated(realisation):
    return load(write("r", realisation))


def test_what_is_computed_on_the_way_can_be_shown(truck, rows):
    """The current of the machine that T4 computes, for conditions like (41), and the wheels' acceleration."""
    choice = truck.residuals["T4_ICDS"]
    names = ["I_em", "der(omega_w)"]
    loaded = residual_generator(truck, choice.equations, choice.consistency, outputs=names)
    runner, currents = Runner(loaded), truck_data.currents(rows, "T4")
    runner.start(**rows[0])
    for k in range(200):
        runner.step(truck_data.DT if k else 0.0, **rows[k])
        assert abs(runner.s[0]["shown_I_em"] - currents[k]) < 1e-9
    assert runner.s[0]["shown_d_omega_w"] == runner.s[0]["d_omega_w"] != 0
    with pytest.raises(ValueError, match='"omega_w" is not computed on the way to e32'):
        realise(truck, choice.equations, choice.consistency, outputs=["omega_w"])


# What cannot be solved
# --------------------------------------------------------------------------------------------------


def loop_model(loops=(), relations=("a + 2 * b = u", "a - b = w", "a * b = y")):
    solvable = {"a": Solvable.UNIQUE, "b": Solvable.UNIQUE}
    knowns = ("u", "w", "y")
    equations = tuple(
        Equation(f"e{k + 1}", ("a", "b"), (knowns[k],), solvable=solvable, relation=Relation.parse(text))
        for k, text in enumerate(relations)
    )
    return Model("loop", equations, ("a", "b"), knowns, loops=loops)


BOTH = (frozenset({"e1", "e2"}), frozenset({"a", "b"}))
SET = frozenset(["e1", "e2", "e3"])


@pytest.mark.long
def test_loops_are_refused_or_solved_as_declared():
    with pytest.raises(NotSolvableError, match=r"algebraic loop \{e1, e2\} .*: not declared"):
        realise(loop_model(), SET, "e3")
    with pytest.raises(NotSolvableError, match="declared as not solvable"):
        realise(loop_model((Loop(*BOTH, Solvable.NONE),)), SET, "e3")
    with pytest.raises(NotSolvableError, match="the model says multiple, algebra finds 1"):
        realise(loop_model((Loop(*BOTH, Solvable.MULTIPLE),)), SET, "e3")
    runner = Runner(residual_generator(loop_model((Loop(*BOTH, Solvable.UNIQUE),)), SET, "e3"))
    assert abs(runner.step(0.0, u=7.0, w=1.0, y=5.0) - (3 * 2 - 5)) < 1e-12
    hard = ("a + exp(b) * b = u", "a**2 - sin(b) = w", "a * b = y")
    with pytest.raises(NotSolvableError, match="algebra (does not solve it|takes too long)"):
        realise(loop_model((Loop(*BOTH, Solvable.UNIQUE),), hard), SET, "e3")


def test_a_second_root_is_not_lost():
    """y1 = x1^2 and y2 = x1: of two roots the residual takes the one that fits, and declaring one is refused."""

    def model(solvable):
        return Model(
            "square",
            (
                Equation("e1", ("x",), ("y1",), solvable={"x": solvable}, relation=Relation.parse("y1 = x**2")),
                Equation("e2", ("x",), ("y2",), relation=Relation.parse("y2 = x")),
            ),
            ("x",),
            ("y1", "y2"),
        )  # fmt: skip

    both = frozenset(["e1", "e2"])
    with pytest.raises(NotSolvableError, match="the model says unique, algebra finds 2"):
        realise(model(Solvable.UNIQUE), both, "e2")
    with pytest.raises(NotSolvableError, match="cannot be solved for x: not declared"):
        realise(model(Solvable.NONE), both, "e2")
    runner = Runner(residual_generator(model(Solvable.MULTIPLE), both, "e2"))
    for x in (3.0, -3.0):
        assert abs(runner.step(0.0, y1=9.0, y2=x)) < 1e-12
        assert abs(runner.step(0.0, y1=9.0, y2=x + np.sign(x)) - np.sign(x)) < 1e-12
    assert np.isnan(runner.step(0.0, y1=-1.0, y2=0.0))


def test_two_sets_of_roots_are_all_combined():
    """Four combinations of roots: |x| from y1, |z| from y2, checked by y3 = x + 2 z."""

    def equation(name, variables, known, text, solvable=None):
        return Equation(name, variables, (known,), solvable=solvable or {}, relation=Relation.parse(text))

    model = Model(
        "roots",
        (
            equation("e1", ("x",), "y1", "y1 = x**2", {"x": Solvable.MULTIPLE}),
            equation("e2", ("z",), "y2", "y2 = z**2", {"z": Solvable.MULTIPLE}),
            equation("e3", ("x", "z"), "y3", "y3 = x + 2 * z"),
        ),
        ("x", "z"),
        ("y1", "y2", "y3"),
    )
    runner = Runner(residual_generator(model, frozenset(["e1", "e2", "e3"]), "e3"))
    assert runner.loaded.generated.realisation.branches == 4
    for x in (-1.0, 1.0):
        for z in (-5.0, 5.0):
            assert abs(runner.step(0.0, y1=1.0, y2=25.0, y3=x + 2 * z)) < 1e-12
    assert abs(runner.step(0.0, y1=1.0, y2=25.0, y3=9.5)) == pytest.approx(0.5)


def test_integrated_states_have_a_value_for_each_root():
    """der(s) = x with x = +-sqrt(y1): each branch integrates its own root, and the one that fits is reported."""
    model = Model(
        "roots",
        (
            Equation("e1", ("x",), ("y1",), solvable={"x": Solvable.MULTIPLE}, relation=Relation.parse("y1 = x**2")),
            Equation("e2", ("der(q)", "x"), solvable={"der(q)": Solvable.UNIQUE},
                relation=Relation.parse("der(q) = x")),
            Equation("e3", ("q",), ("y2",), solvable={"q": Solvable.UNIQUE}, relation=Relation.parse("y2 = q")),
        ),
        ("x", "q"),
        ("y1", "y2"),
        quantities={"q": Quantity(value=1.0)},
    )  # fmt: skip
    everything = frozenset(["e1", "e2", "e3"])
    for direction in (1.0, -1.0):
        runner = Runner(residual_generator(model, everything, "e3"))
        runner.start(y1=4.0, y2=1.0)
        for k in range(20):
            assert abs(runner.step(0.1 if k else 0.0, y1=4.0, y2=1.0 + direction * 0.2 * k)) < 1e-12
        assert abs(runner.step(0.1, y1=4.0, y2=1.0)) == pytest.approx(4.0)
    before = list(runner.s[0]["q"])
    assert list(runner.s[0]["d_q"]) in ([-2.0, 2.0], [2.0, -2.0])
    runner.step(0.0, y1=-1.0, y2=0.0)
    runner.step(0.1, y1=4.0, y2=0.0)
    assert list(runner.s[0]["q"]) == before  # no root was real, nothing was integrated


def test_a_filtered_start_is_made_up_for_in_the_first_sample(load):
    """(38): started with a filtered y of 0.3, the first sample at 0.5 gives alpha (y - LP y), as Gamma + alpha
    x does.
    """
    choice = (model := load("example_4")).residuals["derivative"]
    runner = Runner(residual_generator(model, choice.equations, choice.consistency), filter_bandwidth=2.0)
    runner.start(u=0.0, y=0.3)
    assert runner.step(0.0, u=0.0, y=0.5) == pytest.approx(2.0 * 0.2)
    assert runner.step(0.1, u=0.0, y=0.5) == pytest.approx(2.0 * 0.2 * np.exp(-0.2))


def reciprocal():
    """x = a / y, and x' = u: a sample with y = 0 gives no x."""
    unique = Solvable.UNIQUE
    return Model(
        "reciprocal",
        (
            Equation("e1", ("x",), ("a", "y"), solvable={"x": unique}, relation=Relation.parse("x = a / y")),
            Equation("e2", ("der(x)", "w"), ("u",), solvable={"w": unique}, relation=Relation.parse("der(x) = u * w")),
            Equation("e3", ("w",), ("z",), solvable={"w": unique}, relation=Relation.parse("z = w")),
        ),
        ("x", "w"),
        ("a", "y", "u", "z"),
    )  # fmt: skip


@pytest.mark.parametrize("checked", ["e2", "e3"])
def test_filters_survive_a_sample_that_is_no_number(checked):
    """The filter of (20) and the one that differentiates go on behind it as if it had not come."""
    loaded = residual_generator(reciprocal(), SET, checked, differentiate=True)
    runner = Runner(loaded, filter_bandwidth=2.0, derivative_bandwidth=2.0)
    rows = [{"a": 1.0, "y": 2.0 + 0.1 * k, "u": 1.0, "z": 0.5} for k in range(4)]
    runner.run(rows, 0.1)
    with np.errstate(all="ignore"):
        assert not np.isfinite(runner.step(0.1, a=1.0, y=0.0, u=1.0, z=0.5))
    assert all(np.isfinite(runner.s[0][name]).all() for name in loaded.state.names)
    assert np.isfinite(runner.step(0.1, a=1.0, y=2.5, u=1.0, z=0.5))


def test_a_derivative_that_is_used_elsewhere_too_is_not_avoided():
    """e1 contains der(x) and is checked, but e3 needs it as well: (20) does not help."""
    unique = Solvable.UNIQUE
    model = Model(
        "two uses",
        (
            Equation("e1", ("der(x)", "w"), ("u",), solvable={"w": unique}, relation=Relation.parse("der(x) + w = u")),
            Equation("e2", ("x",), ("y",), solvable={"x": unique}, relation=Relation.parse("y = x")),
            Equation("e3", ("der(x)", "w"), ("z",), solvable={"w": unique},
                relation=Relation.parse("z = w * (1 + der(x)**2)")),
            differential("x", "e4"),
        ),
        ("x", "w"),
        ("u", "y", "z"),
    )  # fmt: skip
    everything = frozenset(["e1", "e2", "e3", "e4"])
    with pytest.raises(NotSolvableError, match="differentiates x"):
        realise(model, everything, "e1")
    runner = Runner(residual_generator(model, everything, "e1", differentiate=True), derivative_bandwidth=50.0)
    rows = [{"u": 2.5, "y": 0.5 * 0.01 * k, "z": 2.0 * 1.25} for k in range(100)]
    assert abs(runner.run(rows, 0.01)[-1]) < 1e-9  # der(x) = 0.5, w = 2


def test_an_explicit_relation_can_be_checked():
    """e5 of (14), d/dt omega - der(omega), as consistency relation: (20) again."""
    model = Model(
        "explicit",
        (
            Equation("e1", ("der(x)",), ("u",), solvable={"der(x)": Solvable.UNIQUE},
                relation=Relation.parse("der(x) = 2 * u")),
            Equation("e2", ("x",), ("y",), solvable={"x": Solvable.UNIQUE}, relation=Relation.parse("y = x")),
            differential("x", "e3"),
        ),
        ("x",),
        ("u", "y"),
    )  # fmt: skip
    everything = frozenset(["e1", "e2", "e3"])
    rng = np.random.default_rng(5)
    rows = [{"u": float(a), "y": float(b)} for a, b in rng.normal(size=(40, 2))]
    results = [
        Runner(residual_generator(model, everything, e), filter_bandwidth=3.0).run(rows, 0.02) for e in ("e3", "e1")
    ]
    close(results[0], results[1])


def test_only_structure_is_said():
    model = Model(
        "m",
        (
            Equation("e1", ("x",), ("y",), solvable={"x": Solvable.UNIQUE}),
            Equation("e2", ("x",), ("z",)),
        ),
        ("x",),
        ("y", "z"),
    )
    with pytest.raises(NotSolvableError, match="equation e1 has no relation"):
        realise(model, frozenset(["e1", "e2"]), "e2")
    with pytest.raises(ValueError, match="do not determine"):
        realise(model, frozenset(["e1"]), "e1")
    with pytest.raises(ValueError, match='no equation "e9"'):
        realise(model, frozenset(["e1", "e2", "e9"]), "e2")
    with pytest.raises(ValueError, match="e3 is not among"):
        realise(model, frozenset(["e1", "e2"]), "e3")


def test_the_code_is_plain_python(truck):
    """Nothing but assignments, conditions, loops over branches and calls of known functions."""
    for name, choice in truck.residuals.items():
        source = write(name, realise(truck, choice.equations, choice.consistency)).source
        tree = ast.parse(source)
        called = {
            node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        assert called <= {
            "means",
            "interpolate",
            "incline",
            "advance",
            "sign",
            "root",
            "sin",
            "exp",
            "min",
            "max",
            "isfinite",
            "float",
        }, name


def test_constants_are_checked(truck):
    loaded = of_truck(truck, "T3_MCDS")
    c = zeros(1, loaded.const)
    loaded.prepare(c[0], values={"m_v0": 30000.0})
    assert c[0]["m_v0"] == 30000.0
    with pytest.raises(ValueError, match='"mass" is no parameter'):
        loaded.prepare(c[0], values={"mass": 1.0})
    with pytest.raises(ValueError, match="filter_bandwidth = 0"):
        loaded.prepare(c[0], filter_bandwidth=0.0)
    nothing = replace(truck, quantities={k: q for k, q in truck.quantities.items() if k != "r_w"})
    choice = truck.residuals["T3_MCDS"]
    bare = residual_generator(
        replace(nothing, quantities={**nothing.quantities, "r_w": Quantity()}),
        choice.equations,
        choice.consistency,
    )
    with pytest.raises(ValueError, match='"r_w" .*no value'):
        bare.prepare(c[0])


# Algebra has a budget
# ----------------------------------------------------------------------------------------------------


def test_algebra_that_takes_too_long_names_what_cures_it(monkeypatch):
    equations = frozenset(["e1", "e2", "e3"])
    realised = realise(spring(), equations, "e3")
    assert write("r", realised)
    monkeypatch.setattr(budget, "CALLS", 100)
    with pytest.raises(NotSolvableError, match=r"x, v: \(24\) takes too long to solve; give them start values"):
        write("r", realised)
    assert write("r", realise(spring(), equations, "e3", start={"x": 1.0, "v": 2.0}))
    cubic = replace(spring().equations[2], relation=Relation.parse("y = x + x * x * x"))
    model = replace(spring(), equations=(*spring().equations[:2], cubic))
    with pytest.raises(NotSolvableError, match="e3: algebra takes too long to solve it; give the solution in the mod"):
        realise(model, equations, "e1")


def test_a_budget_that_is_spent_is_not_caught_within_and_leaves_the_tracer():
    def endless():
        while True:
            with contextlib.suppress(Exception):
                abs(Fraction(1, 3))

    before = sys.gettrace()
    with pytest.raises(budget.TooLongError):
        budget.bounded(endless)
    assert sys.gettrace() is before
    assert budget.bounded(lambda: 3) == 3
