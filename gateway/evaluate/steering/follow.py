"""A run through the monitor itself: the same kernel as on the bus, fed with what the bus would carry."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.engine.tables import table
from gateway.evaluate.steering.cases import DURATION, demand, load, times, wheel
from gateway.jit import kernel
from gateway.monitors.shape import FAILED, RESULTS
from gateway.monitors.steering_angle import MONITOR, monitor
from gateway.monitors.steering_angle.faults import FAULTS
from gateway.monitors.steering_angle.params import Params
from gateway.vecu.steering_column import Column, pinion, sampled
from gateway.vecu.steering_faults import SteeringFault, disturb, falsify
from gateway.vecu.steering_plant import CONTROL, Plant, drive, undisturbed

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """What the bus carries, a row a period.

    Attributes:
        inputs: shape (n,), of the monitor's inputs; frames that have not come anew keep their counter.
        theta: shape (n,), true motor angle [rad].
        omega: shape (n,), true speed [rad/s].
        samples: shape (n,) of SAMPLE.
    """

    inputs: NDArray[np.void]
    theta: Array
    omega: Array
    samples: NDArray[np.void]


@cache
def _course() -> tuple[Array, Array, Array]:
    t = times()
    return demand(t), load(t), wheel(t)


def make(
    plant: Plant,
    scale: float,
    faults: tuple[SteeringFault, ...],
    rng: np.random.Generator,
    *,
    period: float = 1e-3,
    column: Column | None = None,
    celsius: float = 20.0,
) -> Run:
    """Return a run.

    Args:
        plant: motor and drive.
        scale: of the loads.
        faults: what goes wrong.
        rng: source of all randomness.
        period: of the motor's frames [s].
        column: gear and sensors around it.
        celsius: what the winding's sensor says [degC].
    """
    column = column or Column()
    asked, torque, turned = _course()
    wrong = undisturbed(len(asked))
    for fault in faults:
        disturb(wrong, fault, rng)
    samples = drive(plant, asked, scale * torque, wrong, rng, period)
    n = len(samples)
    per = round(period / CONTROL)
    u = np.zeros(n, MONITOR.inputs)
    k = np.arange(n)
    u["t_ns"] = np.rint((k + 1) * period * 1e9).astype(np.int64)
    u["i_u"], u["i_v"] = np.rint(samples["i_u"] * 100) / 100, np.rint(samples["i_v"] * 100) / 100
    step = 360.0 / 65536.0
    electrical = np.degrees(plant.believed.pole_pairs * samples["sensor"])
    u["theta_park"] = np.rint(electrical / step) % 65536 * step
    u["u_sd_mean"], u["u_sq_mean"] = (np.rint(samples[f"u_{x}"] * 1e3) / 1e3 for x in "dq")
    u["mc_cur"] = u["mc_vol"] = k % 16
    u["t_wdg"] = np.rint(celsius)
    for name in ("valid_cur", "valid_ang", "valid_sas", "valid_v"):
        u[name] = 1.0
    # What turns slowly is known at the frames; in between it is straight.
    fine = np.interp(np.arange(len(asked)), (k + 1) * per, samples["theta"])
    true_pinion = pinion(column, fine, turned)
    told_pinion, told_wheel = true_pinion, turned
    for fault in faults:
        told_pinion = falsify(told_pinion, fault, "pinion")
        told_wheel = falsify(told_wheel, fault, "wheel")

    def held(values: Array, every: float) -> tuple[Array, NDArray[np.int64]]:
        """Return what is known at each motor frame, NaN before the first; and of which frame, from 1."""
        number = ((k + 1) * per) // round(every / CONTROL)
        padded = np.concatenate([[np.nan], values])
        return padded[np.minimum(number, len(values))], number

    every = column.angle_period if column.angle_period >= period else period
    stride = round(every / period)
    told_motor = np.rint(np.degrees(samples["sensor"]) / 0.02) * 0.02
    u["delta_m"], number = held(told_motor[stride - 1 :: stride], every)
    u["delta_g"], _ = held(sampled(told_pinion, every, column.pinion_lsb), every)
    u["mc_ang"] = np.where(number > 0, number % 16, np.nan)
    delay = column.wheel_delay
    u["delta_s"], number = held(
        sampled(told_wheel, column.wheel_period, column.wheel_lsb, delay), column.wheel_period
    )
    rate = np.gradient(turned, CONTROL)
    u["delta_s_dot"], _ = held(
        sampled(rate, column.wheel_period, column.rate_lsb, delay), column.wheel_period
    )
    u["mc_sas"] = np.where(number > 0, number % 16, np.nan)
    return Run(u, samples["theta"], samples["omega"], samples)


@dataclass(frozen=True)
class Followed:
    """What the monitor made of a run.

    Attributes:
        found: shape (n,), fault that stands, by its place; -1: none.
        first: shape (faults,), period in which each was first reported as failed, -1: never.
        trace: shape (n, 8): increment, EMF's angle, parity, balance, rate residual, NIS average, estimated angle and
            speed.
        peaks: shape (symptoms,), largest level of each symptom after the warm-up.
    """

    found: NDArray[np.int64]
    first: NDArray[np.int64]
    trace: Array
    peaks: Array


@kernel
def _walk(
    s: Any, c: Any, u: Any, out: Any, found: Any, first: Any, trace: Any, peaks: Any, warm: int
) -> None:
    for k in range(u.shape[0]):
        out.n = 0
        out.send = 0
        monitor.step(s, c, u[k], out)
        for j in range(out.n):
            r = out.results[j]
            if r.result == FAILED and first[r.fault] < 0:
                first[r.fault] = k
        found[k] = s.decision.found
        m = s.electrics
        trace[k, 0] = m.increment
        trace[k, 1] = m.angle
        trace[k, 2] = s.parity
        trace[k, 3] = m.balance
        trace[k, 4] = s.kinematics.wheel
        trace[k, 5] = s.decision.rules[5].level
        trace[k, 6] = m.filter.x[3]
        trace[k, 7] = m.filter.x[2]
        for j in range(peaks.shape[0]):
            level = s.decision.rules[j].level
            if k >= warm:
                peaks[j] = max(peaks[j], level)


def follow(run: Run, params: Params | None = None, warm: float = 1.0) -> Followed:
    """Put a run through the monitor."""
    params = params or Params()
    s, c, out = (table(1, dtype) for dtype in (MONITOR.state, MONITOR.const, RESULTS))
    MONITOR.prepare(params, s[0], c[0])
    n = len(run.inputs)
    found = np.empty(n, np.int64)
    first = np.full(len(FAULTS), -1, np.int64)
    trace, peaks = np.empty((n, 8)), np.zeros(7)
    u = table(n, MONITOR.inputs)
    u[:] = run.inputs
    _walk(s[0], c[0], u, out[0], found, first, trace, peaks, round(warm * n / DURATION))
    return Followed(found, first, trace, peaks)
