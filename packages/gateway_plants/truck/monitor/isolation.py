"""What the hybrid powertrain supplies to the isolation (:mod:`gateway_fdi.isolation`): its signatures and its times.

The signatures are the structural model's fault signature matrix. A fault has its name when its own tests, all of them
and no others, have fired: no other fault has that column.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gateway_fdi.isolation import machine, table
from gateway_fdi.masks import unpack
from gateway_fdi.structure.model import Model
from gateway_plants.truck.monitor.faults import STRUCTURAL

#: Tests that decide: residuals of the structural model.
TESTS = ("T1", "T2", "T5", "T6", "T7")
#: Tests that see a fault only now and then: a resistance shows in T2 above 100 A. Its other test, T5, sees an inverter,
#: too, which T1 sees whenever T5 does.
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

_LENGTHS = {"tests": len(TESTS), "faults": len(STRUCTURAL), "groups": len(STRUCTURAL), "words": 1}


class Const(machine.Const, lengths=_LENGTHS):
    """Constants."""


class State(machine.State, lengths=_LENGTHS):
    """State."""


def seen_by(model: Model, tests: Sequence[str]) -> dict[str, set[str]]:
    """Return the faults that stand in the equations of each test."""
    return {test: {f for e in model.residuals[test].equations for f in model.by_name[e].faults} for test in tests}


def levels(state: Any) -> list[float]:
    """Return the levels of the tests that have fired, 1 at least; NaN of others, for use alone may have them silent.

    Args:
        state: record of State of the monitor.
    """
    fired = unpack(np.asarray(state["isolation"]["fired"])[None, :], len(TESTS))[0]
    return [max(float(level), 1.0) if up else math.nan for level, up in zip(state["level"], fired, strict=True)]


def prepare_table(
    s: State, c: Const, model: Model, tests: Sequence[str], settle_s: float, seldom: Mapping[str, str] | None = None
) -> None:
    """Fill state and constants so that what has fired decides: of the paper's systems no more (the study).

    Args:
        model: the structural model: a test sees the faults that stand in the equations of its set.
        tests: that decide; residuals of the model.
        settle_s: use of the machine without a further test, before a fault is named [s].
        seldom: fault -> its test that sees it only now and then, and need not fire.
    """
    faults = [*seen_by(model, tests).values()]
    signatures = [[k for k, seen in enumerate(faults) if fault in seen] for fault in STRUCTURAL]
    alone = [[k] for k in range(len(STRUCTURAL))]
    rare = seldom or {}
    sure = [[k for k in own if tests[k] != rare.get(name)] for own, name in zip(signatures, STRUCTURAL, strict=True)]
    table.prepare(c, signatures, alone, tests=len(tests), size=len(STRUCTURAL), must=signatures, sure=sure)
    machine.prepare(s, c, confirm_ns=_ns(settle_s), hold_ns=0, pending_ns=_ns(PENDING))
    c.latest_ns, c.near = _ns(LATEST), ON_ITS_WAY
    # What no fault alone explains, no further test does; and a name that a test contradicts is wrong at once.
    c.hopeless_ns = c.withdraw_ns = 0


def prepare(s: State, c: Const, model: Model, settle_s: float) -> None:
    """Fill state and constants of the monitor's (:func:`prepare_table` has the arguments).

    All that has fired since all were quiet decides: a second fault's test that comes down for want of use is not
    forgotten, nor a single one's.
    """
    prepare_table(s, c, model, TESTS, settle_s, SELDOM)
    c.together, c.hold_ns, c.heal_ns = 1, _ns(QUIET), _ns(HEALS)


def _ns(seconds: float) -> int:
    """Return a time in nanoseconds."""
    return round(seconds * 1e9)
