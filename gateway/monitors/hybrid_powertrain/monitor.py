"""The hybrid powertrain's monitor: a step for each complete set of four frames.

Source: paper 004. Corrections: docs/structure.md, and the modules of this folder. A set is complete when its four counters
are equal; time is the counter's steps, not the frames' arrival. A set that is missing is stepped over; behind a gap of more
than :data:`LONGEST` sets the dynamic tests begin anew.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.fdi.structure.file import load_model
from gateway.fdi.structure.generator.records import fill
from gateway.fdi.structure.generator.runtime import interpolate
from gateway.jit import f8, i8, kernel, record
from gateway.monitors.hybrid_powertrain import cusum, excitation, gate, isolation
from gateway.monitors.hybrid_powertrain.excitation import ABSOLUTE, FIXED, SIGNED
from gateway.monitors.hybrid_powertrain.faults import FAULTS, STRUCTURAL, UNISOLATED
from gateway.monitors.hybrid_powertrain.generated import (
    t1,
    t2,
    t3_icds,
    t3_mcds,
    t4_icds,
    t4_mcds,
)
from gateway.monitors.hybrid_powertrain.params import QUANTITIES, Params
from gateway.monitors.shape import Monitor, Wiring, inputs, report
from gateway.resources import shipped

#: Time over which the speed that an integrated residual begins with is corrected [s]. A filter's 0.1 rad/s of noise would
#: stay in the residual for as long as the clutch holds, and in one window of some thousand T would grow without a fault.
CORRECTED = 1.0
#: Sets that may be missing in a row.
LONGEST = 5
#: Sets that T2 waits for a gear change that blanks it.
MOST_BLANK = 64
#: Sets between two reports of the same.
REPEAT = 100

#: Places of the test quantities.
(
    T1,
    T2,
    T3_FIXED,
    T3_SIGNED,
    T3_ABSOLUTE,
    T4_FIXED,
    T4_SIGNED,
    T4_ABSOLUTE,
    T3_MIXED,
    T4_MIXED,
) = range(len(QUANTITIES))

_MESSAGES = {
    "HEV_CTRL_PT": {
        "U_em_ctrl": ("U_em_ctrl", "V"),
        "ice_ctrl": ("ice_ctrl", "J"),
        "u_c": ("u_c", ""),
        "gear": ("gear", ""),
        "count_pt": ("FrameCnt", ""),
    },
    "HEV_CTRL_VEH": {
        "T_b_ctrl": ("T_b_ctrl", "Nm"),
        "alpha": ("alpha", "rad"),
        "count_veh": ("FrameCnt", ""),
    },
    "HEV_SENS_ELEC": {
        "I_b_sens": ("I_b_sens", "A"),
        "U_em_sens": ("U_em_sens", "V"),
        "I_em_sens": ("I_em_sens", "A"),
        "count_elec": ("FrameCnt", ""),
    },
    "HEV_SENS_MECH": {
        "omega_e_sens": ("w_e_sens", "rad/s"),
        "omega_gb_sens": ("w_gb_sens", "rad/s"),
        "charge": ("SoC_start", ""),
        "count_mech": ("FrameCnt", ""),
    },
}

INPUTS = inputs(**{name: f8 for fields in _MESSAGES.values() for name in fields})

#: Residuals of the first second.
START = record(total=f8, count=f8)

CONST = record(
    period=f8,
    mixed=i8,
    blank=i8,
    least_volts=f8,
    excitation=excitation.CONST,
    cusum=(cusum.CONST, len(QUANTITIES)),
    isolation=isolation.CONST,
    t1=t1.CONST,
    t2=t2.CONST,
    t3=t3_icds.CONST,
    t4=t4_icds.CONST,
    t3m=t3_mcds.CONST,
    t4m=t4_mcds.CONST,
)

#: ``on3``, ``on4``: the dynamic tests run. ``held``, ``due``: residuals of T2 that wait, and whether they still count.
STATE = record(
    sets=i8,
    valid=i8,
    fired=i8,
    found=i8,
    explained=i8,
    counter=i8,
    gear=i8,
    reported=i8,
    on3=i8,
    on4=i8,
    at=i8,
    held=(f8, MOST_BLANK),
    due=(i8, MOST_BLANK),
    quiet=i8,
    residual=(f8, 6),
    norm=(f8, len(QUANTITIES)),
    gate=gate.STATE,
    start3=START,
    start4=START,
    three=excitation.STATE,
    four=excitation.STATE,
    cusum=(cusum.STATE, len(QUANTITIES)),
    t1=t1.STATE,
    t2=t2.STATE,
    t3=t3_icds.STATE,
    t4=t4_icds.STATE,
    t3m=t3_mcds.STATE,
    t4m=t4_mcds.STATE,
)


def _wire(_: Params) -> Wiring:
    signals, units = [], {}
    for message, fields in _MESSAGES.items():
        for signal, unit in fields.values():
            signals.append(f"{message}.{signal}")
            if unit:
                units[f"{message}.{signal}"] = unit
    return Wiring(tuple(_MESSAGES), tuple(signals), (), units)


def _prepare(p: Params, s: np.void, c: np.void) -> None:
    model = load_model(shipped("models/hybrid_truck.toml"))
    c["period"], c["mixed"] = 1e-3 * p.period_ms, p.system == "MCDS"
    c["blank"] = min(round(p.blank_ms / p.period_ms), MOST_BLANK - 1)
    c["least_volts"] = p.least_volts
    e = c["excitation"]
    e["after"], e["signed"], e["absolute"] = p.after_s, p.signed_charge, p.absolute_charge
    e["efficiency"] = p.parameters.get("eta_em_0", model.quantities["eta_em_0"].value)
    for k, (name, residual, _) in enumerate(QUANTITIES):
        nu = getattr(p.nu, residual)
        cusum.prepare(c["cusum"][k], nu, nu * getattr(p.thresholds, name), p.limit)
    isolation.prepare(c["isolation"], model)
    for field in ("t1", "t2", "t3", "t4", "t3m", "t4m"):
        fill(c[field], model, values=p.parameters, filter_bandwidth=p.filter_bandwidth)
    s["counter"], s["found"] = -1, -1


@kernel
def _dynamic(s: Any, c: Any, u: Any, dt: float) -> None:
    """Step T3 and T4 of both systems, or begin them anew."""
    gate.update(
        s.gate,
        u.u_c,
        int(u.gear),
        interpolate(c.t2.f_3_x, c.t2.f_3_y, u.gear),
        u.omega_e_sens,
        u.omega_gb_sens,
        dt,
    )
    s.valid = 1 if gate.valid(s.gate) else 0
    measured = u.omega_gb_sens
    if s.valid == 0:
        s.on3 = 0
    else:
        step = dt
        if s.on3 == 0:
            u.omega_gb_sens = gate.speed(s.gate)
            t3_icds.start(s.t3, c.t3, u)
            t3_mcds.start(s.t3m, c.t3m, u)
            u.omega_gb_sens = measured
            excitation.restart(s.three)
            s.start3.total, s.start3.count = 0.0, 0.0
            step = 0.0
        s.residual[2] = t3_icds.step(s.t3, c.t3, u, step)
        s.residual[4] = t3_mcds.step(s.t3m, c.t3m, u, step)
        excitation.update(s.three, c.excitation, s.t3.shown_I_em, s.t3.shown_u_gb, step)
        s.on3 = 1
        settled = _settle(s.start3, s.t3, c.t3, s.residual[2], s.three.time)
        _take(
            s,
            c,
            T3_FIXED,
            s.residual[2],
            settled and excitation.excited(s.three, c.excitation, FIXED),
        )
        _take(
            s,
            c,
            T3_SIGNED,
            s.residual[2],
            settled and excitation.excited(s.three, c.excitation, SIGNED),
        )
        _take(
            s,
            c,
            T3_ABSOLUTE,
            s.residual[2],
            settled and excitation.excited(s.three, c.excitation, ABSOLUTE),
        )
        _take(s, c, T3_MIXED, s.residual[4], excitation.excited(s.three, c.excitation, FIXED))
    if s.valid == 0 or u.U_em_sens < c.least_volts:
        s.on4 = 0
        return
    step = dt
    if s.on4 == 0:
        # The battery is known all the time from T2; T4 runs for a while only.
        s.t4.SoC, s.t4m.SoC = s.t2.SoC, s.t2.SoC
        u.omega_gb_sens = gate.speed(s.gate)
        t4_icds.start(s.t4, c.t4, u)
        t4_mcds.start(s.t4m, c.t4m, u)
        u.omega_gb_sens = measured
        excitation.restart(s.four)
        s.start4.total, s.start4.count = 0.0, 0.0
        step = 0.0
    s.residual[3] = t4_icds.step(s.t4, c.t4, u, step)
    s.residual[5] = t4_mcds.step(s.t4m, c.t4m, u, step)
    excitation.update(s.four, c.excitation, s.t4.shown_I_em, s.t4.shown_u_gb, step)
    s.on4 = 1
    settled = _settle(s.start4, s.t4, c.t4, s.residual[3], s.four.time)
    _take(
        s, c, T4_FIXED, s.residual[3], settled and excitation.excited(s.four, c.excitation, FIXED)
    )
    _take(
        s, c, T4_SIGNED, s.residual[3], settled and excitation.excited(s.four, c.excitation, SIGNED)
    )
    _take(
        s,
        c,
        T4_ABSOLUTE,
        s.residual[3],
        settled and excitation.excited(s.four, c.excitation, ABSOLUTE),
    )
    _take(s, c, T4_MIXED, s.residual[5], excitation.excited(s.four, c.excitation, FIXED))


@kernel
def _settle(start: Any, s: Any, c: Any, residual: float, time: float) -> bool:
    """Correct the speed that a residual (36) began with by its mean over the first second, (24); True behind that."""
    if time <= CORRECTED:
        if residual == residual:  # noqa: PLR0124 - not NaN
            start.total += residual
            start.count += 1.0
        return False
    if start.count > 0.0:
        s.omega_w += start.total / start.count / c.u_f
        start.count = 0.0
        return False
    return True


@kernel
def _take(s: Any, c: Any, place: int, residual: float, wanted: bool) -> None:
    """Update a test quantity, if it is to be updated and the residual is a number."""
    if wanted and residual == residual:  # noqa: PLR0124 - not NaN
        cusum.update(s.cusum[place], c.cusum[place], residual)
        s.norm[place] = cusum.normalised(s.cusum[place], c.cusum[place])


@kernel
def _static(s: Any, c: Any, u: Any, dt: float) -> None:
    """Step T1, and T2, which waits for gear changes that are to come."""
    s.residual[0] = t1.step(s.t1, c.t1, u, dt)
    _take(s, c, T1, s.residual[0], True)
    s.residual[1] = t2.step(s.t2, c.t2, u, dt)
    gear = int(u.gear)
    if gear != s.gear:
        s.gear = gear
        s.quiet = c.blank
        for k in range(MOST_BLANK):
            s.due[k] = 0
    at = s.at % MOST_BLANK
    s.held[at] = s.residual[1]
    s.due[at] = 1 if u.u_c >= gate.ENGAGED and gear > 0 and s.quiet == 0 else 0
    s.quiet = max(s.quiet - 1, 0)
    ready = (s.at - c.blank) % MOST_BLANK
    if s.at >= c.blank and s.due[ready] == 1:
        s.due[ready] = 0
        _take(s, c, T2, s.held[ready], True)
    s.at += 1


@kernel
def _decide(s: Any, c: Any, out: Any) -> None:
    """Report which fault is isolated, or that one is not."""
    three = s.norm[T3_MIXED] if c.mixed == 1 else max(s.norm[T3_SIGNED], s.norm[T3_ABSOLUTE])
    four = s.norm[T4_MIXED] if c.mixed == 1 else max(s.norm[T4_SIGNED], s.norm[T4_ABSOLUTE])
    fired = 0
    if s.norm[T1] > 1.0:
        fired |= 1
    if s.norm[T2] > 1.0:
        fired |= 2
    if three > 1.0:
        fired |= 4
    if four > 1.0:
        fired |= 8
    changed = fired != s.fired
    s.fired = fired
    s.found = isolation.isolated(c.isolation, fired)
    s.explained = isolation.candidates(c.isolation, fired)
    s.reported += 1
    if not changed and s.reported < REPEAT:
        return
    s.reported = 0
    largest = max(s.norm[T1], s.norm[T2], three, four)
    for k in range(UNISOLATED + 1):
        failed = k == s.found if k < UNISOLATED else fired != 0 and s.found < 0
        place = report(out, k, failed, largest, 1.0)
        if place >= 0 and failed:
            e = out.results[place].evidence
            e[0], e[1], e[2], e[3] = s.norm[T1], s.norm[T2], three, four
            e[4], e[5] = fired, s.explained
            e[6], e[7] = s.norm[T3_MIXED], s.norm[T4_MIXED]


@kernel
def step(s: Any, c: Any, u: Any, out: Any) -> None:
    """Take a frame; when its set is complete, step all tests."""
    count = int(u.count_elec)
    if u.count_mech != count or u.count_pt != count or u.count_veh != count or count == s.counter:
        return
    steps = (count - s.counter) & 255 if s.counter >= 0 else 0
    s.counter = count
    if s.sets == 0:
        t2.reset(s.t2, c.t2)
        t2.start(s.t2, c.t2, u)
        t3_icds.reset(s.t3, c.t3)
        t4_icds.reset(s.t4, c.t4)
        t3_mcds.reset(s.t3m, c.t3m)
        t4_mcds.reset(s.t4m, c.t4m)
        s.t2.SoC = u.charge
        s.gear = int(u.gear)
    elif steps > LONGEST:
        gate.restart(s.gate)
        s.on3, s.on4, s.quiet, steps = 0, 0, c.blank, 0
        for k in range(MOST_BLANK):
            s.due[k] = 0
    s.sets += 1
    dt = steps * c.period
    _static(s, c, u, dt)
    _dynamic(s, c, u, dt)
    _decide(s, c, out)


MONITOR = Monitor(
    type="hybrid_powertrain",
    params=Params,
    state=STATE,
    const=CONST,
    inputs=INPUTS,
    step=step,
    faults=FAULTS,
    wire=_wire,
    prepare=_prepare,
    readout=("sets", "valid", "fired", "explained"),
)

assert len(FAULTS) == len(STRUCTURAL) + 1
