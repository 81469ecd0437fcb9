"""The hybrid powertrain's monitor: a step for each complete set of four frames.

Source: paper 004. Corrections: docs/structure.md, and the modules of this folder. A set is complete when its four counters
are equal; time is the counter's steps, not the frames' arrival. A set that is missing is stepped over; behind a gap of more
than :data:`LONGEST` sets the dynamic tests begin anew.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.fdi import cusum
from gateway.fdi.structure.file import load_model
from gateway.fdi.structure.generator.records import fill
from gateway.fdi.structure.generator.runtime import interpolate
from gateway.jit import f8, i8, kernel, record
from gateway.monitors.hybrid_powertrain import (
    blanking,
    dynamic,
    excitation,
    gate,
    isolation,
    observer,
)
from gateway.monitors.hybrid_powertrain.excitation import FIXED
from gateway.monitors.hybrid_powertrain.faults import UNISOLATED, faults_of
from gateway.monitors.hybrid_powertrain.generated import (
    t1,
    t2,
    t3_icds,
    t3_mcds,
    t4_icds,
    t4_mcds,
    t5,
    t6,
    t7,
)
from gateway.monitors.hybrid_powertrain.params import QUANTITIES, Params
from gateway.monitors.shape import (
    CusumCalibration,
    Emission,
    Fault,
    Monitor,
    Wiring,
    inputs,
    report,
)
from gateway.resources import shipped

#: Sets that may be missing in a row.
LONGEST = 5
#: Sets between two reports of the same, and between two messages.
REPEAT, SENT = 100, 10

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
    T5,
    T6,
) = range(len(QUANTITIES))

#: Largest T_norm that the message can carry.
_SHOWN = 5.1

#: Systems by their place.
SYSTEMS = tuple(isolation.TESTS)
ROBUST, MIXED = SYSTEMS.index("RDS"), SYSTEMS.index("MCDS")

#: Fields of the inputs by message: signal and unit.
MESSAGES = {
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

INPUTS = inputs(**{name: f8 for fields in MESSAGES.values() for name in fields})

CONST = record(
    period=f8,
    system=i8,
    tests=i8,
    blank=i8,
    least_volts=f8,
    least_amps=f8,
    excitation=excitation.CONST,
    cusum=(cusum.CONST, len(QUANTITIES)),
    isolation=isolation.CONST,
    observer=observer.CONST,
    t1=t1.CONST,
    t2=t2.CONST,
    t3=t3_icds.CONST,
    t4=t4_icds.CONST,
    t3m=t3_mcds.CONST,
    t4m=t4_mcds.CONST,
    t5=t5.CONST,
    t6=t6.CONST,
    t7=t7.CONST,
)

#: ``residual``: of T1, T2, T3, T4, T3 and T4 with mixed causality, T5, T6, T7; ``level``: T_norm of the tests that decide.
STATE = record(
    sets=i8,
    valid=i8,
    fired=i8,
    found=i8,
    explained=i8,
    counter=i8,
    reported=i8,
    watched=i8,
    level=(f8, isolation.MOST_TESTS),
    blanking=blanking.STATE,
    observer=observer.STATE,
    residual=(f8, 9),
    norm=(f8, len(QUANTITIES)),
    gate=gate.STATE,
    three=dynamic.STATE,
    four=dynamic.STATE,
    cusum=(cusum.STATE, len(QUANTITIES)),
    t1=t1.STATE,
    t2=t2.STATE,
    t3=t3_icds.STATE,
    t4=t4_icds.STATE,
    t3m=t3_mcds.STATE,
    t4m=t4_mcds.STATE,
    t5=t5.STATE,
    t6=t6.STATE,
    t7=t7.STATE,
)


def _wire(_: Params) -> Wiring:
    signals, units = [], {}
    for message, fields in MESSAGES.items():
        for signal, unit in fields.values():
            signals.append(f"{message}.{signal}")
            if unit:
                units[f"{message}.{signal}"] = unit
    return Wiring(tuple(MESSAGES), tuple(signals), (), units)


def _prepare(p: Params, s: np.void, c: np.void) -> None:
    model = load_model(shipped("models/hybrid_truck.toml"))
    c["period"], c["system"] = 1e-3 * p.period_ms, SYSTEMS.index(p.system)
    c["tests"] = len(isolation.TESTS[p.system])
    c["blank"] = min(round(p.blank_ms / p.period_ms), blanking.MOST - 1)
    c["least_volts"], c["least_amps"] = p.least_volts, p.least_amps
    e = c["excitation"]
    e["after"], e["signed"], e["absolute"] = p.after_s, p.signed_charge, p.absolute_charge
    e["efficiency"] = p.parameters.get("eta_em_0", model.quantities["eta_em_0"].value)
    for k, (name, residual, _) in enumerate(QUANTITIES):
        nu = getattr(p.nu, residual)
        cusum.prepare(c["cusum"][k], nu, nu * getattr(p.thresholds, name), p.limit)
    isolation.prepare(c["isolation"], model, p.system)
    for field in ("t1", "t2", "t3", "t4", "t3m", "t4m", "t5", "t6", "t7"):
        fill(c[field], model, values=p.parameters, filter_bandwidth=p.filter_bandwidth)
    _prepare_observer(p, s["observer"], c["observer"], p.least_amps * c["t7"]["k_i"])
    s["counter"], s["found"] = -1, -1


def _sums(s: np.void) -> dict[str, Any]:
    """Return what residuals came to; the observer's has no nu."""
    sums = {key: np.append(s["cusum"][key], 0.0) for key in ("samples", "total", "squares")}
    sums["samples"][-1] = s["observer"]["samples"]
    return sums


def _peaks(s: np.void) -> Any:
    return np.append(s["cusum"]["peak"], s["observer"]["peak"])


def _named(p: Params) -> tuple[Fault, ...]:
    return faults_of(isolation.TESTS[p.system])


def _prepare_observer(p: Params, s: np.void, c: np.void, least: float) -> None:
    w, prior, drift = p.observer, p.observer.prior, p.observer.drift
    c["start"], c["torque"], c["noise"] = w.start**2, w.torque**2, w.speed**2
    c["own"], c["least"], c["threshold"] = w.own**2, least, p.thresholds.T7
    slope = prior.slope**2
    bent = observer.curve(slope, w.slope_way, w.curve_way)
    for place, before, each in (
        (observer.MOTOR, prior.machine, drift.machine),
        (observer.GENERATOR, prior.machine, drift.machine),
        (observer.ENGINE, prior.engine, drift.engine),
        (observer.MASS, prior.mass, drift.mass),
        (observer.BRAKE, prior.brake, drift.brake),
    ):
        c["prior"][place], c["drift"][place] = before**2, each**2
        c["forget"][place] = 0.5 * each**2 / before**2  # so that the prior stays
    c["prior"][observer.SLOPE], c["forget"][observer.SLOPE] = slope, 1.0 / w.slope_way
    c["prior"][observer.CURVE], c["forget"][observer.CURVE] = bent, 1.0 / w.curve_way
    c["drift"][observer.CURVE] = 2.0 * bent / w.curve_way
    observer.prepare(s, c)


@kernel
def _judge(s: Any, c: Any, test: Any, first: int, residual: float) -> float:
    """Update the integral test quantities of T3 or T4; returns what the integrated speed is to be corrected by [rad/s].

    Args:
        s: state.
        c: constants.
        test: of ``s``, T3 or T4.
        first: place of its first test quantity.
        residual: with integral causality.
    """
    settled = dynamic.settled(test)
    for condition in range(3):
        wanted = excitation.excited(test.excitation, c.excitation, condition)
        _take(s, c, first + condition, residual, settled and wanted)
    return dynamic.correction(test, residual)


@kernel
def _three(s: Any, c: Any, u: Any, dt: float) -> None:
    """Step T3, integral and mixed, or begin it anew."""
    step = dt
    if s.three.on == 0:
        measured, u.omega_gb_sens = u.omega_gb_sens, gate.speed(s.gate)
        t3_icds.start(s.t3, c.t3, u)
        t3_mcds.start(s.t3m, c.t3m, u)
        u.omega_gb_sens = measured
        dynamic.begin(s.three)
        step = 0.0
    s.residual[2] = t3_icds.step(s.t3, c.t3, u, step)
    s.residual[4] = t3_mcds.step(s.t3m, c.t3m, u, step)
    e = s.three.excitation
    excitation.update(e, c.excitation, s.t3.shown_I_em, s.t3.shown_u_gb, step)
    s.t3.omega_w += _judge(s, c, s.three, T3_FIXED, s.residual[2]) / c.t3.u_f
    _take(s, c, T3_MIXED, s.residual[4], excitation.excited(e, c.excitation, FIXED))


@kernel
def _four(s: Any, c: Any, u: Any, dt: float) -> None:
    """Step T4, integral and mixed, or begin it anew."""
    step = dt
    if s.four.on == 0:
        # The battery is known all the time from T2; T4 runs for a while only.
        s.t4.SoC, s.t4m.SoC = s.t2.SoC, s.t2.SoC
        measured, u.omega_gb_sens = u.omega_gb_sens, gate.speed(s.gate)
        t4_icds.start(s.t4, c.t4, u)
        t4_mcds.start(s.t4m, c.t4m, u)
        u.omega_gb_sens = measured
        dynamic.begin(s.four)
        step = 0.0
    s.residual[3] = t4_icds.step(s.t4, c.t4, u, step)
    s.residual[5] = t4_mcds.step(s.t4m, c.t4m, u, step)
    e = s.four.excitation
    excitation.update(e, c.excitation, s.t4.shown_I_em, s.t4.shown_u_gb, step)
    s.t4.omega_w += _judge(s, c, s.four, T4_FIXED, s.residual[3]) / c.t4.u_f
    _take(s, c, T4_MIXED, s.residual[5], excitation.excited(e, c.excitation, FIXED))


@kernel
def _seven(s: Any, c: Any, u: Any, dt: float) -> None:
    """Step T7 with its observer, or begin it anew."""
    step = dt
    if s.watched == 0:
        measured, u.omega_gb_sens = u.omega_gb_sens, gate.speed(s.gate)
        t7.start(s.t7, c.t7, u)
        u.omega_gb_sens = measured
        observer.restart(s.observer, c.observer)
        s.watched = 1
        step = 0.0
    s.residual[8] = t7.step(s.t7, c.t7, u, step)
    observer.update(s.observer, c.observer, s.t7, c.t7, s.residual[8], u.T_b_ctrl, step)


@kernel
def _dynamic(s: Any, c: Any, u: Any, dt: float) -> None:
    """Step the tests that need a clutch that holds."""
    ratio = interpolate(c.t2.f_3_x, c.t2.f_3_y, u.gear)
    gate.update(s.gate, u.u_c, int(u.gear), ratio, u.omega_e_sens, u.omega_gb_sens, dt)
    s.valid = 1 if gate.valid(s.gate) else 0
    if s.valid == 0:
        s.three.on, s.four.on, s.watched = 0, 0, 0
        way = dt * c.t7.r_w * u.omega_gb_sens / c.t7.u_f
        observer.age(s.observer, c.observer, dt, way if way == way else 0.0)  # noqa: PLR0124 - not NaN
        return
    _three(s, c, u, dt)
    _seven(s, c, u, dt)
    if u.U_em_sens < c.least_volts:
        s.four.on = 0
    else:
        _four(s, c, u, dt)


@kernel
def _take(s: Any, c: Any, place: int, residual: float, wanted: bool) -> None:
    """Update a test quantity, if it is to be updated and the residual is a number."""
    if wanted and residual == residual:  # noqa: PLR0124 - not NaN
        cusum.update(s.cusum[place], c.cusum[place], residual)
        s.norm[place] = cusum.normalised(s.cusum[place], c.cusum[place])


@kernel
def _static(s: Any, c: Any, u: Any, dt: float) -> None:
    """Step T1, T6, and T2 and T5, which wait for gear changes that are to come.

    They need no speed of the vehicle, but a machine that is used: at rest no fault shows, and T would come down (V-C).
    """
    used = abs(u.I_em_sens) >= c.least_amps
    s.residual[0] = t1.step(s.t1, c.t1, u, dt)
    volts = max(abs(u.U_em_ctrl), abs(u.U_em_sens))
    _take(s, c, T1, s.residual[0], volts >= c.least_volts)
    s.residual[7] = t6.step(s.t6, c.t6, u, dt)
    _take(s, c, T6, s.residual[7], used)
    s.residual[1] = t2.step(s.t2, c.t2, u, dt)
    s.residual[6] = t5.step(s.t5, c.t5, u, dt)
    gear = int(u.gear)
    counts = used and u.u_c >= gate.ENGAGED and gear > 0
    place = blanking.put(s.blanking, c.blank, gear, counts, s.residual[1], s.residual[6])
    if place >= 0:
        _take(s, c, T2, s.blanking.held[place, 0], True)
        _take(s, c, T5, s.blanking.held[place, 1], True)


@kernel
def _weigh(s: Any, c: Any) -> int:
    """Put T_norm of the tests that decide in their places; returns those that have fired, as bits."""
    s.level[0], s.level[1] = s.norm[T1], s.norm[T2]
    if c.system == ROBUST:
        s.level[2], s.level[3], s.level[4] = s.norm[T5], s.norm[T6], s.observer.norm
    elif c.system == MIXED:
        s.level[2], s.level[3] = s.norm[T3_MIXED], s.norm[T4_MIXED]
    else:
        # Remark 4: two conditions, either of which suffices.
        s.level[2] = max(s.norm[T3_SIGNED], s.norm[T3_ABSOLUTE])
        s.level[3] = max(s.norm[T4_SIGNED], s.norm[T4_ABSOLUTE])
    fired = 0
    for place in range(len(s.level)):
        if s.level[place] > 1.0:
            fired |= 1 << place
    return fired


@kernel
def _decide(s: Any, c: Any, out: Any) -> None:
    """Report which fault is isolated, or that one is not."""
    fired = _weigh(s, c)
    changed = fired != s.fired
    s.fired = fired
    s.found = isolation.isolated(c.isolation, fired)
    s.explained = isolation.candidates(c.isolation, fired)
    s.reported += 1
    if not changed and s.reported < REPEAT:
        return
    s.reported = 0
    largest = 0.0
    for place in range(len(s.level)):
        largest = max(largest, s.level[place])
    for k in range(UNISOLATED + 1):
        failed = k == s.found if k < UNISOLATED else fired != 0 and s.found < 0
        place = report(out, k, failed, largest, 1.0)
        if place >= 0 and failed:
            e = out.results[place].evidence
            for j in range(c.tests):
                e[j] = s.level[j]
            e[c.tests] = fired
            e[c.tests + 1] = isolation.ranked(c.isolation, s.explained, s.level)
            e[c.tests + 2] = s.observer.error[observer.MOTOR]


@kernel
def _tell(s: Any, out: Any) -> None:
    """Send how far the tests are, and the diagnosis: the fault's place and 1, or 6 for one that is not isolated."""
    out.send = 1
    for place in range(len(s.level)):
        out.values[place] = min(s.level[place], _SHOWN)
    at = len(s.level)
    out.values[at] = s.fired
    out.values[at + 1] = s.found + 1 if s.found >= 0 else (UNISOLATED + 1 if s.fired else 0)
    out.values[at + 2] = s.valid


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
        t6.reset(s.t6, c.t6)
        t6.start(s.t6, c.t6, u)
        t7.reset(s.t7, c.t7)
        t3_icds.reset(s.t3, c.t3)
        t4_icds.reset(s.t4, c.t4)
        t3_mcds.reset(s.t3m, c.t3m)
        t4_mcds.reset(s.t4m, c.t4m)
        s.t2.SoC, s.t6.SoC = u.charge, u.charge
        s.blanking.gear = int(u.gear)
    elif steps > LONGEST:
        gate.restart(s.gate)
        blanking.forget(s.blanking, c.blank)
        s.three.on, s.four.on, s.watched, steps = 0, 0, 0, 0
    s.sets += 1
    dt = steps * c.period
    _static(s, c, u, dt)
    _dynamic(s, c, u, dt)
    _decide(s, c, out)
    if s.sets % SENT == 0:
        _tell(s, out)


MONITOR = Monitor(
    type="hybrid_powertrain",
    params=Params,
    state=STATE,
    const=CONST,
    inputs=INPUTS,
    step=step,
    faults=(),
    named=_named,
    wire=_wire,
    prepare=_prepare,
    calibration=CusumCalibration(
        quantities=(*((name, residual) for name, residual, _ in QUANTITIES), ("T7", "")),
        floors={"T7": observer.FLOOR},
        sums=_sums,
        peaks=_peaks,
    ),
    emission=Emission(
        "FDI_STATUS",
        (*(f"Tn_{k + 1}" for k in range(isolation.MOST_TESTS)), "Fired", "Diagnosis", "Valid"),
    ),
    readout=("sets", "valid", "fired", "explained"),
)
