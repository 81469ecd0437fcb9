"""A run through the monitor itself: the same kernel as on the bus, fed with what the bus would carry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.monitors.contract import FAILED
from gateway_fdi.jit import kernel, zeros
from gateway_plants.steering.ecu.column import Column
from gateway_plants.steering.ecu.controller import CONTROL
from gateway_plants.steering.ecu.course import sweep, times
from gateway_plants.steering.ecu.faults import SteeringFault
from gateway_plants.steering.ecu.plant import Plant
from gateway_plants.steering.ecu.signals import sense
from gateway_plants.steering.monitor import MONITOR, monitor
from gateway_plants.steering.monitor.faults import FAULTS
from gateway_plants.steering.monitor.params import Params
from gateway_plants.steering.study.cases import DURATION

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


def make(
    plant: Plant,
    scale: float,
    faults: tuple[SteeringFault, ...],
    rng: np.random.Generator,
    *,
    period: float = 1e-3,
    celsius: float = 20.0,
) -> Run:
    """Return a run of the study's course.

    Args:
        plant: motor and drive.
        scale: of the loads.
        faults: what goes wrong.
        rng: source of all randomness.
        period: of the motor's frames [s].
        celsius: what the winding's sensor says [degC].
    """
    column = Column()
    told = sense(plant, column, sweep(times(DURATION), scale), faults, period, rng)
    samples = told.samples
    n = len(samples)
    k = np.arange(n)
    u = np.zeros(n, MONITOR.inputs)
    u["t_ns"] = np.rint((k + 1) * period * 1e9).astype(np.int64)
    u["i_u"], u["i_v"] = (np.rint(samples[f"i_{x}"] * 100) / 100 for x in "uv")
    step = 360.0 / 65536.0
    electrical = np.degrees(plant.believed.pole_pairs * samples["sensor"])
    u["theta_park"] = np.rint(electrical / step) % 65536 * step
    u["u_sd_mean"], u["u_sq_mean"] = (np.rint(samples[f"u_{x}"] * 1e3) / 1e3 for x in "dq")
    u["mc_cur"] = u["mc_vol"] = k % 16
    u["t_wdg"] = np.rint(celsius)
    for name in ("valid_cur", "valid_ang", "valid_sas", "valid_v"):
        u[name] = 1.0

    def arrived(every: float, counter: str, columns: dict[str, Array]) -> None:
        """Put in what is known at each motor frame of a message of another period; NaN before its first."""
        number = (k + 1) * round(period / CONTROL) // round(every / CONTROL)
        u[counter] = np.where(number > 0, number % 16, np.nan)
        for name, values in columns.items():
            padded = np.concatenate([[np.nan], values])
            u[name] = padded[np.minimum(number, len(values))]

    every = max(column.angle_period, period)
    motor = np.rint(told.motor / 0.02) * 0.02
    arrived(every, "mc_ang", {"delta_m": motor, "delta_g": told.pinion})
    arrived(column.wheel_period, "mc_sas", {"delta_s": told.wheel, "delta_s_dot": told.rate})
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
def _walk(s: Any, c: Any, u: Any, out: Any, found: Any, first: Any, trace: Any, peaks: Any, warm: int) -> None:
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
        trace[k, 5] = s.symptoms.rules[5].level
        trace[k, 6] = m.filter.x[3]
        trace[k, 7] = m.filter.x[2]
        for j in range(peaks.shape[0]):
            level = s.symptoms.rules[j].level
            if k >= warm:
                peaks[j] = max(peaks[j], level)


def follow(run: Run, params: Params | None = None, warm: float = 1.0) -> Followed:
    """Put a run through the monitor."""
    params = params or Params()
    s, c, out = (zeros(1, dtype) for dtype in (MONITOR.state, MONITOR.const, MONITOR.results))
    MONITOR.prepare(params, s[0], c[0])
    n = len(run.inputs)
    found = np.empty(n, np.int64)
    first = np.full(len(FAULTS), -1, np.int64)
    trace, peaks = np.empty((n, 8)), np.zeros(7)
    u = zeros(n, MONITOR.inputs)
    u[:] = run.inputs
    _walk(s[0], c[0], u, out[0], found, first, trace, peaks, round(warm * n / DURATION))
    return Followed(found, first, trace, peaks)
