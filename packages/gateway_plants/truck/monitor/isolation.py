"""What the hybrid powertrain supplies to the isolation (:mod:`gateway_fdi.isolation`): its signatures and its times.

The signatures are the structural model's fault signature matrix. A fault has its name when its own tests, all of them
and no others, have fired: no other fault has that column.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gateway_fdi.isolation import machine, table
from gateway_fdi.masks import unpack
from gateway_fdi.structure.model import Model
from gateway_plants.truck.monitor.faults import STRUCTURAL

#: Tests that decide, by system: residuals of the structural model. RDS is beyond the paper.
TESTS = {
    "ICDS": ("T1", "T2", "T3_ICDS", "T4_ICDS"),
    "MCDS": ("T1", "T2", "T3_MCDS", "T4_MCDS"),
    "RDS": ("T1", "T2", "T5", "T6", "T7"),
}
MOST_TESTS = max(map(len, TESTS.values()))
#: With RDS, tests that see a fault only now and then: a resistance shows in T2 above 100 A. Its other test, T5, sees an
#: inverter, too, which T1 sees whenever T5 does.
SELDOM = {"f_em_R": "T2"}
#: Use of the machine without a test that has fired, after which what had fired is forgotten [s].
QUIET = 20.0
#: Likewise, after which a fault that has its name is taken to be gone: its tests come down while little current flows.
HEALS = 60.0
#: T_norm of a test that may fire.
ON_ITS_WAY = 0.5
#: Use of the machine, and time in all, for which a fault that may be named yet is not told as one that is not isolated:
#: its tests fire one after the other, as the machine is used [s].
PENDING, LATEST = 60.0, 180.0

_LENGTHS = {"tests": MOST_TESTS, "faults": len(STRUCTURAL), "groups": len(STRUCTURAL), "words": 1}


class Const(machine.Const, lengths=_LENGTHS):
    """Constants."""


class State(machine.State, lengths=_LENGTHS):
    """State."""


def seen_by(model: Model, system: str) -> dict[str, set[str]]:
    """Return the faults that stand in the equations of each test of a system."""
    return {
        test: {f for e in model.residuals[test].equations for f in model.by_name[e].faults} for test in TESTS[system]
    }


def levels(state: Any) -> list[float]:
    """Return the levels of the tests that have fired, 1 at least; NaN of others, for use alone may have them silent.

    Args:
        state: record of State of the monitor.
    """
    fired = unpack(np.asarray(state["isolation"]["fired"])[None, :], MOST_TESTS)[0]
    return [max(float(level), 1.0) if up else math.nan for level, up in zip(state["level"], fired, strict=True)]


def prepare(s: State, c: Const, model: Model, system: str, settle_s: float) -> None:
    """Fill state and constants from the faults that stand in the equations of the tests' sets.

    Args:
        s: record of State.
        c: record of Const.
        model: the structural model.
        system: of TESTS.
        settle_s: with RDS, use of the machine without a further test, before a fault is named [s].
    """
    faults = [*seen_by(model, system).values()]
    signatures = [[k for k, seen in enumerate(faults) if fault in seen] for fault in STRUCTURAL]
    alone = [[k] for k in range(len(STRUCTURAL))]
    # With the paper's systems what has fired decides; beyond it what has since all were quiet: a second fault's test
    # that comes down for want of use is not forgotten, nor a single one's.
    robust = system == "RDS"
    seldom = [SELDOM.get(fault) if robust else None for fault in STRUCTURAL]
    sure = [[k for k in own if TESTS[system][k] != name] for own, name in zip(signatures, seldom, strict=True)]
    table.prepare(c, signatures, alone, tests=len(TESTS[system]), size=len(STRUCTURAL), must=signatures, sure=sure)
    machine.prepare(s, c, confirm_ns=_ns(settle_s) if robust else 0, hold_ns=0, pending_ns=_ns(PENDING))
    c.latest_ns, c.near = _ns(LATEST), ON_ITS_WAY
    # What no fault alone explains, no further test does; and a name that a test contradicts is wrong at once.
    c.hopeless_ns = c.withdraw_ns = 0
    if robust:
        c.together, c.hold_ns, c.heal_ns = 1, _ns(QUIET), _ns(HEALS)


def _ns(seconds: float) -> int:
    """Return a time in nanoseconds."""
    return round(seconds * 1e9)
