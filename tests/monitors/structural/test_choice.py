"""Which tests are chosen: as few as the toolbox's isolability wants, of the causality asked for, none that drifts."""

import numpy as np
import pytest

from gateway.common.resources import shipped
from gateway.fdi.structure.analysis import analyse
from gateway.fdi.structure.file import load_model
from gateway.fdi.structure.isolability import isolability_of_tests
from gateway.monitors.structural.choice import choose
from gateway.monitors.structural.params import Params

pytestmark = pytest.mark.long


def chosen(name, **keys):
    model = load_model(shipped(f"models/{name}.toml"))
    return model, choose(model, Params(model=f"{name}.toml", **keys))


@pytest.mark.parametrize("causality", ["integral", "mixed"])
@pytest.mark.parametrize("name", ["motor", "three_tanks", "truck", "machine"])
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
