"""Constants and state of the hybrid powertrain's monitor, and how they begin."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from gateway_fdi import cusum
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors, nearest
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, means, u1
from gateway_fdi.slow import filter as slow
from gateway_fdi.slow import lag
from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.generator.records import fill
from gateway_fdi.structure.model import Model
from gateway_plants.truck.monitor import alignment, blanking, gate, isolation, observer
from gateway_plants.truck.monitor.generated import t1, t2, t5, t6, t7
from gateway_plants.truck.monitor.messages import Inputs
from gateway_plants.truck.monitor.params import QUANTITIES, Params

#: Places of the test quantities.
T1, T2, T5, T6 = range(len(QUANTITIES))

#: Places of the residuals.
R1, R2, R5, R6, R7 = range(5)
RESIDUAL_NAMES = ("T1", "T2", "T5", "T6", "T7")
RESIDUALS = len(RESIDUAL_NAMES)

#: Errors that are followed, by their place: of winding, magnets, open circuit voltage, cells; gain and bias of the
#: sensors of voltage, of the machine's and of the battery's current.
WINDING, MAGNETS, OPEN, CELLS, U_GAIN, U_BIAS, I_GAIN, I_BIAS, B_GAIN, B_BIAS = range(10)
#: Groups that are refused together; what is in none has its own number.
MACHINE, BATTERY = slow.MOST, slow.MOST + 1


class Const(Record):
    """Constants."""

    period: f8 = means("period of the sets", "s")
    blank: i8 = means("sets before and behind a gear change that do not count")
    least_volts: f8 = means("voltage of the machine from which on T1 is tested", "V")
    least_amps: f8 = means("current of the machine from which on T2, T5 and T6 are tested", "A")
    cusum: Annotated[list[cusum.Const], len(QUANTITIES)] = means("CUSUM of each quantity")
    isolation: isolation.Const = means("from tests to faults")
    observer: observer.Const = means("constants of the observer T7")
    follows: i8 = means("1: slow errors are followed")
    ageing: slow.Const = means("bounds and rates of the slow errors")
    most_lag: f8 = means("largest lag of the electric sensors", "sets")
    voltage_noise: f8 = means("what e8 leaves, at the machine", "V")
    speed_noise: f8 = means("noise of the gearbox's speed", "rad/s")
    power_noise: f8 = means("what e11 leaves", "W")
    t1: t1.Const = means("constants of T1")
    t2: t2.Const = means("constants of T2")
    t5: t5.Const = means("constants of T5")
    t6: t6.Const = means("constants of T6")
    t7: t7.Const = means("constants of T7")


class State(Record):
    """State."""

    sets: i8 = means("sets taken")
    valid: i8 = means("1: the model of T7 holds")
    fired: i8 = means("tests above their threshold, as bits")
    explained: i8 = means("faults that explain what has fired, as bits")
    reported: i8 = means("sets since the tests were reported")
    watched: i8 = means("1: T7 runs")
    untested: i8 = means("why tests are not at work, as bits (:mod:`.following`)")
    winding: f8 = means("relative error of R_em that is followed")
    magnets: f8 = means("relative error of k_i that is followed")
    open_volts: f8 = means("relative error of U_oc that is followed")
    cells: f8 = means("relative error of R_b that is followed")
    lag_ms: f8 = means("by which the electric sensors are late", "ms")
    level: Annotated[f8s, len(isolation.TESTS)] = means("T_norm of the tests that decide")
    blanking: blanking.State = means("residuals that wait for a gear change")
    observer: observer.State = means("state of the observer T7")
    residual: Annotated[f8s, RESIDUALS] = means("by the places above")
    norm: Annotated[f8s, len(QUANTITIES)] = means("T_norm of each quantity")
    gate: gate.State = means("when the model holds")
    cusum: Annotated[list[cusum.State], len(QUANTITIES)] = means("CUSUM of each quantity")
    alignment: alignment.State = means("signals of a set at one time")
    corrected: Inputs = means("the set without what is found of the sensors' errors")
    ageing: slow.State = means("slow errors that are followed")
    blocks: Annotated[list[slow.Block], 3] = means("sums of the three equations that ageing takes")
    h_1: Annotated[f8s, slow.MOST] = means("sensitivities of the first equation")
    h_2: Annotated[f8s, slow.MOST] = means("sensitivities of the second equation")
    h_3: Annotated[f8s, slow.MOST] = means("sensitivities of the third equation")
    h: Annotated[f8s, slow.MOST] = means("scratch")
    known: Annotated[i8s, 2] = means("blocks of machine and battery in which their errors were known")
    taken: Annotated[i8s, 2] = means("blocks of machine and battery")
    q2: t2.Const = means("constants of T2 with what ageing found")
    q5: t5.Const = means("constants of T5 with what ageing found")
    q6: t6.Const = means("constants of T6 with what ageing found")
    doubts: Annotated[f8s, blanking.MOST, blanking.LANES] = means("doubts of the residuals that wait in blanking")
    use: f8 = means("use of the machine that the isolation has not seen yet", "s")
    unisolated: u1 = means("1: a fault that is not isolated is told")
    named: i8 = means("the fault that is told; -1: none")
    isolation: isolation.State = means("from tests to faults")
    t1: t1.State = means("state of T1")
    t2: t2.State = means("state of T2")
    t5: t5.State = means("state of T5")
    t6: t6.State = means("state of T6")
    t7: t7.State = means("state of T7")


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
    c.period = 1e-3 * p.period_ms
    c.blank = min(round(p.blank_ms / p.period_ms), blanking.MOST - 1)
    c.least_volts, c.least_amps = p.least_volts, p.least_amps
    for k, name in enumerate(QUANTITIES):
        nu = getattr(p.nu, name)
        cusum.prepare(c.cusum[k], nu, nu * getattr(p.thresholds, name), p.limit)
    isolation.prepare(s.isolation, c.isolation, model, p.settle_s)
    for field in ("t1", "t2", "t5", "t6", "t7"):
        fill_generator(p, getattr(c, field), model)
    _prepare_following(p, s, c)
    _prepare_observer(p, s.observer, c.observer, p.least_amps * c.t7.k_i)
    s.named = -1


def fill_generator(p: Params, c: Any, model: Model, filter_bandwidth: float = 0.5) -> None:
    """Fill the constants of a residual generator, with the parameters and tables of the configuration."""
    values = dict(p.parameters)
    if "f_3" in p.tables:
        values.setdefault("n_g", p.tables["f_3"].x[-1])
    fill(c, model, values=values, filter_bandwidth=filter_bandwidth)
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
    followed = p.follow
    c.follows = followed is not False
    if followed is False:
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
