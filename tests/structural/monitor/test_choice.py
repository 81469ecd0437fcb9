"""Which tests are chosen: as few as the toolbox's isolability wants, of the causality asked for, none that drifts."""

import ast
from dataclasses import replace

import numpy as np
import pytest

from bench.battery_pack import battery_model
from gateway_fdi.common.resources import shipped
from gateway_fdi.structure.analysis import analyse
from gateway_fdi.structure.file import load_model, load_own_model
from gateway_fdi.structure.isolability import isolability_of_tests
from gateway_plants.structural.monitor.choice import choose
from gateway_plants.structural.monitor.filters import bandwidths, of_meter
from gateway_plants.structural.monitor.params import Params
from gateway_plants.structural.monitor.source import module_of

pytestmark = pytest.mark.long


def chosen(name, **keys):
    model = load_model(shipped(f"models/{name}.toml"))
    return model, choose(model, Params(model=f"{name}.toml", **keys))


@pytest.mark.parametrize("causality", ["integral", "mixed"])
@pytest.mark.parametrize(
    "name", ["motor", "three_tanks", "truck", pytest.param("machine", marks=pytest.mark.full("10 s"))]
)
def test_they_tell_as_much_as_all_and_are_as_few_as_can_be(name, causality):
    model, plan = chosen(name, causality=causality)
    analysis = analyse(model)
    every = analysis.isolability("SDI", "realizable")
    assert (plan.isolability.confused == every.confused).all()
    assert plan.isolability.detectable.all()
    for left_out in plan.tests:
        rows = [[f in t.faults for f in model.faults] for t in plan.tests if t is not left_out]
        fewer = isolability_of_tests(model.faults, np.array(rows, bool).reshape(len(rows), len(model.faults)))
        assert (fewer.confused != every.confused).any() or (fewer.detectable != every.detectable).any()


def test_the_truck_has_as_many_as_the_paper():
    """As many as T1 to T4 of its Appendix B, which isolate all five faults too, with integral causality."""
    _, plan = chosen("truck")
    assert len(plan.tests) == 4
    assert plan.isolability.full
    assert {test.causality for test in plan.tests} == {"S", "SI"}


def test_mixed_causality_checks_the_motion():
    _, plan = chosen("motor", causality="mixed")
    assert [(t.consistency, t.causality) for t in plan.tests] == [("e1", "S")] + [("e3", "SD")] * 3
    assert len({t.name for t in plan.tests}) == 4


def test_what_never_forgets_is_told_and_not_chosen():
    """p2 from q1 - q2, of which neither depends on it: whatever it is off by stays."""
    model, auto = chosen("three_tanks")
    assert not any(test.drifting for test in auto.tests)
    equations = {"e2", "e3", "e4", "e5", "e6", "e7", "e8", "e9", "e10", "e11", "e12"}
    rows = [set(analyse(model).structure.names(row)) for row in analyse(model).msos]
    number = rows.index(equations) + 1
    _, named = chosen("three_tanks", tests=(f"{number}:e2",), unseen=("fV1",))
    assert set(named.tests[0].drifting) == {"p2", "p3"}
    assert any("does not forget all of it" in line for line in named.told)
    assert any("should start" in line for line in named.told)


TANK = """
[unknown]
q = { unit = "l/s" }
h = { unit = "m" }
T = { unit = "degC" }
[known]
u = { unit = "1" }
P = { unit = "kW" }
T_in = { unit = "degC" }
y_h = { unit = "m" }
y_T = { unit = "degC" }
[fault]
f_p = {}
f_P = {}
f_h = {}
f_T = {}
[parameter]
k_p = { value = 2.0, unit = "l/s" }
c = { value = 1.0 }
A = { value = 100.0 }
cw = { value = 4.2 }
[equation.e1]
relation = "q = k_p * (1 - f_p) * u"
unique = ["q"]
[equation.e2]
relation = "A * der(h) = q - c * sqrt(h)"
unique = ["der(h)", "q", "h"]
[equation.e3]
relation = "A * h * cw * der(T) = P * (1 - f_P) + cw * q * (T_in - T)"
unique = ["der(T)", "h", "q", "T"]
[equation.e4]
relation = "y_h = h + f_h"
unique = ["h"]
[equation.e5]
relation = "y_T = T + f_T"
unique = ["T"]
"""


@pytest.fixture
def tank(tmp_path):
    """A heated tank: level and temperature, both measured."""
    (tmp_path / "tank.toml").write_text(TANK)
    return load_own_model(tmp_path / "tank.toml", key="model")


def plan_of(model, **keys):
    return choose(model, Params(model="tank.toml", **keys))


def test_a_start_by_slopes_is_none(tank):
    """The level from the temperature's slope, which a monitor does not know where it begins: 0 / 0. The temperature's
    own start its sensor says."""
    plan = plan_of(tank)
    (test,) = (t for t in plan.tests if t.equations == ("e1", "e2", "e3", "e5"))
    assert test.guessed == ("h",)
    assert any("where h should start" in line for line in plan.told)
    assert not any("should start" in line for line in plan_of(tank, start={"h": 1.44}).told)


def test_a_size_does_not_lag_behind_a_fitted_filter(tank):
    """The pump's size by the level's slope: not by the bandwidth that the noise of a test would want."""
    p = Params(model="tank.toml", period_ms=1000.0, settle_s=600.0, noise={"y_h": 0.002, "y_T": 0.05})
    plan = choose(tank, p)
    meter = plan.generators[plan.measured["f_p"]]
    assert meter.differentiated == ("h",)
    assert meter not in plan.tests
    assert of_meter(p).derivative == 10.0
    assert of_meter(p.model_copy(update={"period_ms": 10.0})).derivative == 100.0
    assert bandwidths(meter, p).derivative < 0.1  # of a test: 10 s behind and more


def test_a_large_model_hangs_on_no_needlessly_large_test(tmp_path):
    """A pack of 16 cells: the resistances by two cells, or by the sensors of the others, not by the models of all."""
    (tmp_path / "pack.toml").write_text(battery_model(16))
    plan = choose(load_own_model(tmp_path / "pack.toml", key="model"), Params(model="pack.toml", sizes=False))
    assert plan.isolability.full
    sizes = sorted(len(test.equations) for test in plan.tests)
    assert sizes[:-3] == [4] * sum(size == 4 for size in sizes) + [6] * sum(size == 6 for size in sizes)


def test_a_monitor_of_many_tests_hides_no_name():
    """Its module has a module for each test, and kernels' types beside them: with nine tests one was named f8."""
    model, plan = chosen("motor")
    tree = ast.parse(module_of(replace(plan, tests=plan.tests * 4), tuple(model.knowns)))
    names = [n.asname or n.name for node in ast.walk(tree) if hasattr(node, "names") for n in node.names]
    assert len(names) > 2 * 4 * len(plan.tests)
    assert sorted(names) == sorted(set(names))
