"""Statements: a cause, one of few, not isolated; told when they have stood."""

import numpy as np
import pytest

from gateway_fdi.evidence import posterior
from gateway_fdi.evidence.model import Fault, Model

CASES = {
    "a cause": ([0.995, 0.004, 0.0, 0.0, 0.0, 0.001], posterior.CAUSE, [0], 0.995),
    "likely, not sure": ([0.01, 0.97, 0.01, 0.0, 0.0, 0.01], posterior.ONE_OF, [1], 0.97),
    "one of three": ([0.4, 0.0, 0.35, 0.21, 0.0, 0.04], posterior.ONE_OF, [0, 2, 3], 0.96),
    "four are too many": ([0.25, 0.25, 0.25, 0.24, 0.0, 0.01], posterior.NOT_ISOLATED, [], 0.99),
    "the model is wrong": ([0.3, 0.0, 0.0, 0.0, 0.69, 0.01], posterior.NOT_ISOLATED, [], 0.99),
    "it may be no fault": ([0.9, 0.0, 0.0, 0.0, 0.0, 0.1], posterior.NOTHING, [], 0.1),
}


@pytest.mark.parametrize("case", CASES)
def test_it_is_told_when_it_has_stood_and_the_ratio_is_large_enough(case):
    probability, kind, faults, sure = CASES[case]
    every = tuple(Fault(f"f{k}", (0,), 1.0, common=k < 4) for k in range(5))
    s, c = Model((), every, np.eye(1), 1.0, 1, threshold=20.0, confirm=2).records()
    s.probability[:] = probability
    assert [posterior.tell(s, c, 19.0) for _ in range(3)] == [False] * 3
    assert s.kind == posterior.NOTHING
    changes = [posterior.tell(s, c, 21.0) for _ in range(3)]
    assert changes == [False, kind != posterior.NOTHING, False]
    assert s.kind == kind
    assert [f for f in s.named if f >= 0] == faults
    assert s.sure == pytest.approx(sure)
