"""Constants and state of the hybrid powertrain's monitor, and how they begin."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from gateway_fdi import cusum
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors, nearest
from gateway_fdi.jit import Record, f8, f8s, i8, u1
from gateway_fdi.slow import filter as slow
from gateway_fdi.slow import lag
from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.generator.records import fill
from gateway_plants.truck.monitor import alignment, blanking, dynamic, excitation, gate, isolation, observer
from gateway_plants.truck.monitor.generated import t1, t2, t3_icds, t3_mcds, t4_icds, t4_mcds, t5, t6, t7
from gateway_plants.truck.monitor.messages import Inputs
from gateway_plants.truck.monitor.params import QUANTITIES, Params

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

#: Places of the residuals: of T1 to T4, of T3 and T4 with mixed causality, of T5 to T7.
R1, R2, R3, R4, R3_MIXED, R4_MIXED, R5, R6, R7 = range(9)
RESIDUAL_NAMES = ("T1", "T2", "T3", "T4", "T3 (mixed)", "T4 (mixed)", "T5", "T6", "T7")
RESIDUALS = len(RESIDUAL_NAMES)

#: Errors that are followed, by their place: of winding, magnets, open circuit voltage, cells; gain and bias of the
#: sensors of voltage, of the machine's and of the battery's current.
WINDING, MAGNETS, OPEN, CELLS, U_GAIN, U_BIAS, I_GAIN, I_BIAS, B_GAIN, B_BIAS = range(10)
#: Groups that are refused together; what is in none has its own number.
MACHINE, BATTERY = slow.MOST, slow.MOST + 1

#: Systems by their place.
SYSTEMS = tuple(isolation.TESTS)
ROBUST, MIXED = SYSTEMS.index("RDS"), SYSTEMS.index("MCDS")


class Const(Record):
    """Constants."""

    period: f8
    system: i8
    tests: i8
    blank: i8
    least_volts: f8
    least_amps: f8
    excitation: excitation.Const
    cusum: Annotated[list[cusum.Const], len(QUANTITIES)]
    isolation: isolation.Const
    observer: observer.Const
    follows: i8
    ageing: slow.Const
    most_lag: f8
    voltage_noise: f8
    speed_noise: f8
    power_noise: f8
    t1: t1.Const
    t2: t2.Const
    t3: t3_icds.Const
    t4: t4_icds.Const
    t3m: t3_mcds.Const
    t4m: t4_mcds.Const
    t5: t5.Const
    t6: t6.Const
    t7: t7.Const


class State(Record):
    """State.

    ``residual``: by the places above; ``level``: T_norm of the tests that decide. ``three``, ``four``: what T3 and T4
    with integral causality (``t3``, ``t4``) and with mixed (``t3m``, ``t4m``) have in common; ``watched``: T7 runs;
    ``untested``: why tests are not at work, as bits (:mod:`.following`); ``winding``, ``magnets``, ``open_volts``,
    ``cells``: relative errors of R_em, k_i, U_oc and R_b that are followed; ``lag_ms``: by which the electric sensors
    are late.

    ``alignment``: of a set's signals to one time; ``corrected``: the set without what is found of the sensors' errors;
    ``ageing``: what is followed, by ``blocks`` of the three equations, whose sensitivities are ``h_1``, ``h_2``,
    ``h_3`` (``h``: scratch); blocks of machine and battery that were ``taken``, and in which they were ``known``;
    ``q2``, ``q5``, ``q6``: constants of T2, T5 and T6 with it; ``doubts``: of the residuals that wait in ``blanking``.

    ``fired``: tests above their threshold, as bits; ``use`` of the machine that the isolation has not seen yet [s];
    ``named``: the fault that is told, -1: none; ``unisolated``: that is told; ``explained``: faults that explain what
    has fired, as bits.
    """

    sets: i8
    valid: i8
    fired: i8
    explained: i8
    reported: i8
    watched: i8
    untested: i8
    winding: f8
    magnets: f8
    open_volts: f8
    cells: f8
    lag_ms: f8
    level: Annotated[f8s, isolation.MOST_TESTS]
    blanking: blanking.State
    observer: observer.State
    residual: Annotated[f8s, RESIDUALS]
    norm: Annotated[f8s, len(QUANTITIES)]
    gate: gate.State
    three: dynamic.State
    four: dynamic.State
    cusum: Annotated[list[cusum.State], len(QUANTITIES)]
    alignment: alignment.State
    corrected: Inputs
    ageing: slow.State
    blocks: Annotated[list[slow.Block], 3]
    h_1: Annotated[f8s, slow.MOST]
    h_2: Annotated[f8s, slow.MOST]
    h_3: Annotated[f8s, slow.MOST]
    h: Annotated[f8s, slow.MOST]
    machine_known: i8
    machine_taken: i8
    battery_known: i8
    battery_taken: i8
    q2: t2.Const
    q5: t5.Const
    q6: t6.Const
    doubts: Annotated[f8s, blanking.MOST, blanking.LANES]
    use: f8
    unisolated: u1
    named: i8
    isolation: isolation.State
    t1: t1.State
    t2: t2.State
    t3: t3_icds.State
    t4: t4_icds.State
    t3m: t3_mcds.State
    t4m: t4_mcds.State
    t5: t5.State
    t6: t6.State
    t7: t7.State


def prepare(p: Params, s: State, c: Const) -> None:
    """Fill constants and state before the first step.

    Raises:
        InputError: a parameter that the model does not have, or a table with more points than the model's.
        InputErrors: several.
    """
    model = load_model(shipped("models/truck.toml"))
    wrong = [
        InputError(
            f"models/truck.toml has no such parameter{nearest(name, model.parameters)}",
            key=f"parameters.{name}",
            value=value,
        )
        for name, value in p.parameters.items()
        if name not in model.parameters
    ]
    wrong += [
        InputError(f"{len(table.x)} points; at most {room}", key=f"tables.{name}")
        for name, table in p.tables.items()
        if len(table.x) > (room := len(model.tables[name].x))
    ]
    if wrong:
        raise InputErrors(wrong) if len(wrong) > 1 else wrong[0]
    c.period, c.system = 1e-3 * p.period_ms, SYSTEMS.index(p.system)
    c.tests = len(isolation.TESTS[p.system])
    c.blank = min(round(p.blank_ms / p.period_ms), blanking.MOST - 1)
    c.least_volts, c.least_amps = p.least_volts, p.least_amps
    e = c.excitation
    e.after, e.signed, e.absolute = p.after_s, p.signed_charge, p.absolute_charge
    efficiency = model.quantities["eta_em_0"].value
    assert efficiency is not None
    e.efficiency = p.parameters.get("eta_em_0", efficiency)
    for k, (name, residual, _) in enumerate(QUANTITIES):
        nu = getattr(p.nu, residual)
        cusum.prepare(c.cusum[k], nu, nu * getattr(p.thresholds, name), p.limit)
    isolation.prepare(s.isolation, c.isolation, model, p.system, p.settle_s)
    values = dict(p.parameters)
    if "f_3" in p.tables:
        values.setdefault("n_g", p.tables["f_3"].x[-1])
    for field in ("t1", "t2", "t3", "t4", "t3m", "t4m", "t5", "t6", "t7"):
        fill(getattr(c, field), model, values=values, filter_bandwidth=p.filter_bandwidth)
        _set_tables(p, getattr(c, field))
    _prepare_following(p, s, c)
    _prepare_observer(p, s.observer, c.observer, p.least_amps * c.t7.k_i)
    s.named = -1


def _set_tables(p: Params, c: Any) -> None:
    """Put the tables of the configuration into the constants of a residual generator."""
    for name, table in p.tables.items():
        if f"{name}_x" not in c.dtype.names:
            continue
        spare = len(c[f"{name}_x"]) - len(table.x)
        c[f"{name}_x"] = [*table.x, *(table.x[-1] + 1e-6 * (k + 1) for k in range(spare))]
        c[f"{name}_y"] = [*table.y, *[table.y[-1]] * spare]


def _prepare_following(p: Params, s: State, c: Const) -> None:
    # Fields one by one: the state's are copies that change.
    copies: tuple[tuple[Any, Any], ...] = ((s.q2, c.t2), (s.q5, c.t5), (s.q6, c.t6))
    for mine, told in copies:
        for name in told.dtype.names:
            mine[name] = told[name]
    followed = p.followed
    c.follows = followed is not None
    if followed is None:
        return
    e = c.ageing
    e.count = B_BIAS + 1
    for k, one in (
        (WINDING, followed.resistance),
        (MAGNETS, followed.torque_constant),
        (OPEN, followed.open_circuit_voltage),
        (CELLS, followed.battery_resistance),
    ):
        e.low[k], e.high[k], e.rate[k], e.prior[k] = one.low, one.high, one.rate, max(-one.low, one.high)
        # A sensor that is wrong from the start bends what is found of both: what one is told is nearer then.
        e.group[k] = MACHINE if k in (WINDING, MAGNETS) else BATTERY
    sensors = p.sensors
    for k, most in (
        (U_GAIN, sensors.U_em.gain),
        (U_BIAS, sensors.U_em.bias.value),
        (I_GAIN, sensors.I_em.gain),
        (I_BIAS, sensors.I_em.bias.value),
        (B_GAIN, sensors.I_b.gain),
        (B_BIAS, sensors.I_b.bias.value),
    ):
        # A data sheet has the largest error: two standard deviations.
        e.low[k], e.high[k], e.rate[k], e.prior[k] = -most, most, most / sensors.over_s, 0.5 * most
        e.group[k] = BATTERY if k in (B_GAIN, B_BIAS) else k
    c.voltage_noise, c.power_noise, c.speed_noise = followed.voltage_noise, followed.power_noise, p.observer.speed
    c.most_lag = min(followed.lag_ms / p.period_ms, lag.MOST)
    slow.prepare(s.ageing, e)


def _prepare_observer(p: Params, s: observer.State, c: observer.Const, least: float) -> None:
    w, prior, drift = p.observer, p.observer.prior, p.observer.drift
    c.start, c.torque, c.noise = w.start**2, w.torque**2, w.speed**2
    c.own, c.least, c.threshold = w.own**2, least, p.thresholds.T7
    slope = prior.slope**2
    bent = observer.curve(slope, w.slope_way, w.curve_way)
    for place, before, each in (
        (observer.MOTOR, prior.machine, drift.machine),
        (observer.GENERATOR, prior.machine, drift.machine),
        (observer.ENGINE, prior.engine, drift.engine),
        (observer.MASS, prior.mass, drift.mass),
        (observer.BRAKE, prior.brake, drift.brake),
    ):
        c.prior[place], c.drift[place] = before**2, each**2
        c.forget[place] = 0.5 * each**2 / before**2  # so that the prior stays
    c.prior[observer.SLOPE], c.forget[observer.SLOPE] = slope, 1.0 / w.slope_way
    c.prior[observer.CURVE], c.forget[observer.CURVE] = bent, 1.0 / w.curve_way
    c.drift[observer.CURVE] = 2.0 * bent / w.curve_way
    observer.prepare(s, c)


def sums(s: Any) -> dict[str, Any]:
    """Return what residuals came to; the observer's has no nu."""
    found = {key: np.append(s.cusum[key], 0.0) for key in ("samples", "total", "squares")}
    found["samples"][-1] = s.observer.samples
    return found


def peaks(s: Any) -> Any:
    """Return the largest T_norm of each quantity, and of T7."""
    return np.append(s.cusum["peak"], s.observer.peak)
