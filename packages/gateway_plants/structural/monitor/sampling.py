"""What a sample is for the tests: the first, one that begins anew, one that goes on; or none.

The engine makes the samples (:mod:`gateway.monitors.sampling`). A message that stays away is missing in them: its
inputs are NaN, the generators that read it give no number, and the others go on. An input that is no number though its
message has come is waited for likewise. Behind too many samples that are missing, or while the model did not hold,
everything begins anew, and settles.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

from gateway.monitors.sampling import periods_in
from gateway_checks.rule.machine import run
from gateway_fdi.jit import kernel
from gateway_fdi.masks import clear, disjoint, include
from gateway_plants.structural.monitor.records import Const, State

#: What :func:`arrived` says: no sample; go on; begin anew; the very first.
NOTHING, GO, BEGIN, FIRST = range(4)


@kernel
def _is_left_out(s: State, c: Const, u: Any) -> bool:
    """Tell whether a sample is of no use: an input is no number, and may be one soon; or no test has all it needs."""
    whole = True
    for k in range(c.inputs):
        whole = whole and (c.wanted[k] == 0 or isfinite(u.value[k]))
    if whole:
        s.left_out = 0
        return False
    clear(s.gone)
    for k in range(c.inputs):
        if c.wanted[k] == 1 and not isfinite(u.value[k]):
            include(s.gone, k)
    if u.missing == 0.0 and s.left_out < c.missing:
        s.left_out += 1
        return True
    for k in range(c.tests):
        if disjoint(s.gone, c.reads[k]):
            return False
    return True


@kernel
def arrived(s: State, c: Const, u: Any) -> int:
    """Take a sample; returns what is to be done now, and leaves the time since the sample before in ``s.dt``."""
    s.at_ns = u.t_ns
    s.missed += int(u.gap) - 1
    s.periods += int(u.gap)
    if _is_left_out(s, c, u):
        s.missed += 1
        return NOTHING
    if c.active.length > 0:
        holds = run(s.active, c.active, s.at_ns, u.value, 0.0)
        if s.active.unknown == 1 or holds == 0.0:
            s.running = 0
            return NOTHING
    apart = s.at_ns - s.last_ns
    whole = s.periods if c.counted == 1 else periods_in(apart, c.period_ns)
    apart = whole * c.period_ns if whole > 0 else apart  # behind a late frame, or period_ms is wrong
    what = GO if s.running == 1 and apart <= c.gap_ns else BEGIN if s.begun == 1 else FIRST
    s.dt = apart * 1e-9 if what == GO else 0.0
    if what != GO:
        s.since_ns = s.at_ns
        s.window = 0
    s.running, s.begun = 1, 1
    s.last_ns, s.periods = s.at_ns, 0
    s.samples += 1
    return what
