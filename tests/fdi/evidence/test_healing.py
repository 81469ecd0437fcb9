"""A fault that has gone is no more told, and the next one is told by its own name."""

import numpy as np

from gateway_fdi.evidence import posterior, record
from gateway_fdi.evidence.model import Fault, Model, Slow

SEED = 6704


def plant():
    faults = (
        Fault("a", (0,), 3.0, 0.05),
        Fault("b", (0, 1), 3.0, 0.05),
        Fault("unknown", (0, 1), 3.0, per_h=1e-6, present=1e-5, common=False),
    )
    return Model((Slow("x", 0.5, 1e-3),), faults, 0.04 * np.eye(2), 0.1, 10, 0.1, 25.0)


def drive(rng, sizes, shows):
    """Return a record with sizes of both faults, shape (n, 2), and of what the plant shows of them, shape (n,)."""
    n = len(sizes)
    h = np.ones((n, 2, 1))
    g = np.stack([shows, shows, -shows, np.ones(n), np.ones(n)], 1)
    r = rng.normal(0.0, 0.2, (n, 2)) + 0.3
    r += np.stack([(sizes[:, 0] + sizes[:, 1]) * shows, -sizes[:, 1] * shows], 1)
    return r, h, g


def test_a_fault_that_has_gone_is_no_more_told_and_the_next_one_is():
    print("seed", SEED)
    sizes = np.zeros((2400, 2))
    sizes[400:1000, 0], sizes[1600:, 1] = 1.0, 0.8
    told = record.over(plant(), *drive(np.random.default_rng(SEED), sizes, np.ones(2400))).told
    assert [told[k].kind for k in (30, 60, 99, 150, 200, 239)] == [
        posterior.NOTHING, posterior.CAUSE, posterior.CAUSE, posterior.NOTHING, posterior.CAUSE, posterior.CAUSE,
    ]  # fmt: skip
    assert (told[99].faults, told[239].faults) == ((0,), (1,))
    assert abs(told[60].since - 40) <= 1
    assert abs(told[239].since - 160) <= 1
    gone = next(k for k in range(99, 150) if told[k].kind == posterior.NOTHING)
    assert gone - 100 <= 2 * 13


def test_a_fault_that_the_plant_does_not_show_stands():
    print("seed", SEED)
    sizes, shows = np.zeros((2000, 2)), np.ones(2000)
    sizes[400:, 0], shows[800:] = 1.0, 0.0
    told = record.over(plant(), *drive(np.random.default_rng(SEED), sizes, shows)).told
    assert all(told[k].faults == (0,) for k in range(50, 200))
