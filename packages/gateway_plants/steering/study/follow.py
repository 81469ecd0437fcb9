"""A run through the monitor itself: the same kernel as on the bus, fed with what the bus would carry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.monitors import sampling
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
from gateway_plants.steering.monitor.monitor import ANGLE, PAIR, STEERED, samplings
from gateway_plants.steering.monitor.params import Params
from gateway_plants.steering.study.cases import DURATION

Array = NDArray[np.float64]

#: Frames of a period: the monitor's inputs, and the counters of the angles, that are none.
ROW = np.dtype([*MONITOR.inputs.dtype.descr, ("mc_ang", "f8"), ("mc_sas", "f8")])
#: Messages in the order in which they come in a period: counter, sampling, number in it.
_ORDER = (("mc_ang", ANGLE, 0), ("mc_sas", STEERED, 0), ("mc_cur", PAIR, 0), ("mc_vol", PAIR, 1))
_WHICH, _MESSAGE = (np.array([row[k] for row in _ORDER]) for k in (1, 2))
#: What a pair has of its currents' row, and of its voltages'.
_OF_PAIR = (("i_u", "i_v", "theta_park", "valid_cur"), ("u_sd_mean", "u_sq_mean", "t_wdg"))


@dataclass(frozen=True)
class Run:
    """What the bus carries, a row a period.

    Attributes:
        inputs: shape (n,) of ROW; frames that have not come anew keep their counter.
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
    u = np.zeros(n, ROW)
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


class _Samples(sampling.State, lengths={"messages": 2}):
    """What has come of the messages of a sampling."""


@kernel
def _collect(s: Any, c: Any, t_ns: Any, counters: Any, last: Any, kept: Any, of: Any, gap: Any, waited: Any) -> int:
    """Find the samples; returns how many. ``of``: row, sampling, rows of a pair's currents and voltages."""
    came = 0
    for k in range(t_ns.shape[0]):
        for j in range(4):
            count = counters[k, j]
            if np.isnan(count) or count == last[j]:
                continue
            last[j], x, d = count, s[_WHICH[j]], c[_WHICH[j]]
            found = sampling.take(x, d, _MESSAGE[j], t_ns[k], count)
            if found != sampling.OVERTAKEN:
                kept[_MESSAGE[j], x.place] = k
            if found == sampling.SAMPLE:
                of[came, 0], of[came, 1] = k, _WHICH[j]
                of[came, 2], of[came, 3] = kept[0, x.place], kept[1, x.place]
                gap[came], waited[came] = x.gap, sampling.waited(x, d, 0, t_ns[k])
                came += 1
    return came


def samples_of(rows: NDArray[np.void], params: Params) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    """Return the monitor's inputs, a row a sample as the engine makes them, and the row that each came with.

    Args:
        rows: shape (n,) of ROW.
        params: of the monitor.
    """
    s, c = zeros(3, _Samples), zeros(3, sampling.Const)
    for k, (const, asked) in enumerate(zip(c, samplings(params), strict=True)):
        sampling.prepare(const, asked, 2 if k == PAIR else 1)
    most = 3 * len(rows)
    of, gap, waited = np.zeros((most, 4), np.int64), np.zeros(most), np.zeros(most)
    counters = np.stack([rows[name] for name, *_ in _ORDER], axis=1).astype(float)
    last, kept = np.full(len(_ORDER), np.nan), np.zeros((2, sampling.MOST_DEPTH), np.int64)
    n = _collect(s, c, np.ascontiguousarray(rows["t_ns"]), counters, last, kept, of, gap, waited)
    u, of = zeros(n, MONITOR.inputs), of[:n]
    for name in MONITOR.inputs.dtype.names or ():
        u[name] = rows[name][of[:, 0]]
    u["which"], u["gap"], u["waited"][:, 0] = of[:, 1], gap[:n], waited[:n]
    pair = of[:, 1] == PAIR
    for k, names in enumerate(_OF_PAIR):
        for name in names:
            u[name][pair] = rows[name][of[pair, 2 + k]]
    return u, of[:, 0]


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
    s: Any, c: Any, u: Any, row: Any, out: Any, found: Any, first: Any, trace: Any, peaks: Any, warm: int
) -> None:
    for i in range(u.shape[0]):
        k = row[i]
        out.n = 0
        out.send = 0
        monitor.step(s, c, u[i], out)
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
    found = np.full(n, -1, np.int64)
    first = np.full(len(FAULTS), -1, np.int64)
    trace, peaks = np.zeros((n, 8)), np.zeros(7)
    u, row = samples_of(run.inputs, params)
    _walk(s[0], c[0], u, row, out[0], found, first, trace, peaks, round(warm * n / DURATION))
    newest = np.zeros(n, np.int64)
    newest[row] = row
    newest = np.maximum.accumulate(newest)  # between two samples nothing changes
    return Followed(found[newest], first, trace[newest], peaks)
