"""All estimators on one run: the paper's four, and the ones with the angle as a state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from gateway_bench.study_pool import Progress, run
from gateway_fdi.filters import ekf_alpha_beta, feedforward
from gateway_fdi.filters.motor import Motor
from gateway_fdi.filters.transforms import clarke, park
from gateway_fdi.jit import Record, f8s, kernel, means, zeros
from gateway_plants.steering.ecu.course import sweep, times
from gateway_plants.steering.ecu.plant import Plant, drive, undisturbed
from gateway_plants.steering.study.cases import DURATION
from gateway_plants.steering.study.filters import ekf_dq, luenberger, reduced_luenberger

Array = NDArray[np.float64]

#: Estimators by their column. "own": Park with the own angle; "held": below 0.3 V of EMF; "printed": the sign of (46).
NAMES = (
    "Luenberger",
    "reduced Luenberger",
    "EKF3 dq",
    "EKF4 dq + load",
    "EKF3 dq, own angle",
    "feedforward",
    "feedforward, held",
    "feedforward, sign as printed",
    "EKF4 ab",
    "EKF5 ab",
    "EKF5 ab, anchored",
)
LO, REDUCED, EKF3, EKF4_DQ, EKF3_OWN, FF, FF_HELD, FF_PRINTED, EKF4_AB, EKF5_AB, ANCHORED = range(11)

#: Resistance of a winding that is 76 K warmer than the estimators take it for (copper: 0.393 %/K).
WARM = 1.3
#: What the research note has, on a set-up of which it does not give every time: angle rms, mechanical [deg].
NOTE = (521.0, 318.0, 133.0, 6.1, 141.0, 671.0, 124.0, 1170.0, 2.2, 1.24, float("nan"))

_FEEDFORWARD = "feedforward of the EMF; one that holds its angle while that is small; the sign of (46) as printed"
_IN_STATOR_FRAME = "extended Kalman filter in stator co-ordinates; with the load; with it, anchored at standstill"


class Constants(Record):
    """Constants of all estimators; EKF3 with its own angle has those of EKF3."""

    lo: luenberger.Const = means("Luenberger observer")
    reduced: reduced_luenberger.Const = means("reduced Luenberger observer")
    ekf3: ekf_dq.Const = means("extended Kalman filter in rotor co-ordinates")
    ekf4: ekf_dq.Const = means("the same with the load")
    ff: Annotated[list[feedforward.Const], 3] = means(_FEEDFORWARD)
    ab: Annotated[list[ekf_alpha_beta.Const], 3] = means(_IN_STATOR_FRAME)


class States(Record):
    """States of all estimators, in the order of :data:`NAMES`."""

    lo: luenberger.State = means("Luenberger observer")
    reduced: reduced_luenberger.State = means("reduced Luenberger observer")
    ekf3: ekf_dq.State = means("extended Kalman filter in rotor co-ordinates")
    ekf4: ekf_dq.State = means("the same with the load")
    ekf3_own: ekf_dq.State = means("ekf3 with Park by its own angle")
    ff: Annotated[list[feedforward.State], 3] = means(_FEEDFORWARD)
    ab: Annotated[list[ekf_alpha_beta.State], 3] = means(_IN_STATOR_FRAME)


@kernel
def _step_in_rotor_frame(c: Constants, s: States, u_d: float, u_q: float, i_d: float, i_q: float) -> None:
    """Step the estimators that take Park with the sensor's angle; voltages [V], currents [A]."""
    luenberger.step(s.lo, c.lo, u_q, i_q)
    reduced_luenberger.step(s.reduced, c.reduced, u_q, i_q)
    ekf_dq.step(s.ekf3, c.ekf3, u_d, u_q, i_d, i_q)
    ekf_dq.step(s.ekf4, c.ekf4, u_d, u_q, i_d, i_q)


@kernel
def _step_own_angle(c: Constants, s: States, z: float, u_a: float, u_b: float, i_a: float, i_b: float) -> None:
    """Step EKF3 with Park by its own angle; ``z`` pole pairs, voltages [V] and currents [A] alpha and beta."""
    own = s.ekf3_own
    o_d, o_q = park(u_a, u_b, z * own.theta)
    ekf_dq.predict(own, c.ekf3, o_d, o_q)
    o_d, o_q = park(i_a, i_b, z * own.theta)
    ekf_dq.correct(own, c.ekf3, o_d, o_q)


@kernel
def _step_in_stator_frame(
    c: Constants, s: States, u_1: float, u_2: float, frame: float, turned: float, i_a: float, i_b: float, sensor: float
) -> None:  # fmt: skip
    """Step the estimators with the angle as a state.

    Args:
        u_1: voltage, d in the frame [V].
        u_2: voltage, q in the frame [V].
        frame: electrical angle of the voltages' frame at the step's beginning [rad].
        turned: by so much it turned within the step [rad].
        i_a: current, alpha [A].
        i_b: current, beta [A].
        sensor: measured angle, mechanical [rad], for the anchored one.
    """
    for j in range(3):
        ekf_alpha_beta.step(s.ab[j], c.ab[j], u_1, u_2, frame, turned, i_a, i_b)
    ekf_alpha_beta.hold(s.ab[2], c.ab[2], sensor, 1.0)


@kernel
def _write(c: Constants, s: States, r: f8s) -> None:
    """Write angles and speeds of a sample, shape (2 n,)."""
    n = len(r) // 2
    r[LO], r[n + LO] = s.lo.theta, s.lo.omega
    r[REDUCED], r[n + REDUCED] = s.reduced.theta, s.reduced.omega
    r[EKF3], r[n + EKF3] = s.ekf3.theta, s.ekf3.x[2]
    r[EKF4_DQ], r[n + EKF4_DQ] = s.ekf4.theta, s.ekf4.x[2]
    r[EKF3_OWN], r[n + EKF3_OWN] = s.ekf3_own.theta, s.ekf3_own.x[2]
    # The EMF is that of the middle of the step.
    omega = s.ab[1].x[2]
    half = 0.5 * omega * c.ab[1].h * c.ab[1].steps
    for j in range(3):
        r[FF + j], r[n + FF + j] = s.ff[j].theta + half, omega
        r[EKF4_AB + j], r[n + EKF4_AB + j] = s.ab[j].x[3], s.ab[j].x[2]


@kernel
def _estimate(c: Constants, s: States, x: Any, z: float, mean_dq: bool, out: f8s) -> None:
    """Run all estimators over samples.

    Args:
        x: samples, shape (n,) of SAMPLE.
        z: pole pairs.
        mean_dq: whether voltages are means in the controller's frame, else in the stator's.
        out: angles and speeds, shape (n, 22).
    """
    last = z * x[0].sensor
    for j in range(3):
        ekf_alpha_beta.begin(s.ab[j], c.ab[j], x[0].sensor)
    for k in range(x.shape[0]):
        m = x[k]
        theta = z * m.sensor
        i_a, i_b = clarke(m.i_u, m.i_v)
        i_d, i_q = park(i_a, i_b, theta)
        u_a, u_b = m.u_alpha, m.u_beta
        frame, turned = 0.0, 0.0
        u_d, u_q = park(u_a, u_b, 0.5 * (theta + last))
        u_1, u_2 = u_a, u_b
        if mean_dq:
            u_d, u_q = m.u_d, m.u_q
            u_1, u_2, frame, turned = u_d, u_q, last, theta - last
        _step_in_rotor_frame(c, s, u_d, u_q, i_d, i_q)
        _step_own_angle(c, s, z, u_a, u_b, i_a, i_b)
        for j in range(3):
            feedforward.step(s.ff[j], c.ff[j], u_a, u_b, i_a, i_b)
        _step_in_stator_frame(c, s, u_1, u_2, frame, turned, i_a, i_b, m.sensor)
        last = theta
        _write(c, s, out[k])


def _constants(m: Motor, period: float) -> Any:
    """Return the constants of all estimators, for samples at a period [s]."""
    c = zeros(1, Constants)[0]
    luenberger.prepare(c.lo, m, period)
    reduced_luenberger.prepare(c.reduced, m, period)
    ekf_dq.prepare(c.ekf3, m, period, load=False, voltage=0.02, torque=1.2, current=0.1)
    ekf_dq.prepare(c.ekf4, m, period, load=True)
    feedforward.prepare(c.ff[0], m, period, held=0.0)
    feedforward.prepare(c.ff[1], m, period)
    feedforward.prepare(c.ff[2], m, period, held=0.0, printed=True)
    ekf_alpha_beta.prepare(c.ab[0], m, period, load=False, voltage=0.0114, torque=1.35, current=0.44, slow=0.0)
    ekf_alpha_beta.prepare(c.ab[1], m, period, slow=0.0)
    ekf_alpha_beta.prepare(c.ab[2], m, period)
    return c


def estimate(samples: NDArray[np.void], period: float, *, mean_dq: bool = False) -> Array:
    """Run all estimators over samples, shape (n,) of SAMPLE.

    Args:
        samples: of the plant.
        period: of the samples [s].
        mean_dq: voltages as means in the controller's frame, as the bus has them; else in the stator's.

    Returns:
        shape (n, 22): angles [rad] and speeds [rad/s] in the order of :data:`NAMES`.
    """
    m = Motor()
    s = zeros(1, States)[0]
    s.ff["theta_e"] = m.pole_pairs * samples["sensor"][0]  # they begin at the sensor's angle
    x = zeros(len(samples), samples.dtype)
    x[:] = samples
    out = np.zeros((len(samples), 2 * len(NAMES)))
    _estimate(_constants(m, period), s, x, float(m.pole_pairs), mean_dq, out)
    return out


def nominal(seed: int, period: float, resistance: float = 1.0) -> NDArray[np.void]:
    """Return the study's course with all noise and the nominal motor, but for a factor of its resistance."""
    course = sweep(times(DURATION))
    wrong = undisturbed(len(course.motor))
    rng = np.random.default_rng(seed)
    told = Motor()
    plant = Plant(motor=replace(told, resistance=resistance * told.resistance))
    return drive(plant, course.motor, course.load, wrong, rng, period)


@dataclass
class Accuracy:
    """Errors of an estimator, means over the seeds.

    ``resistance``: of the motor, of which the estimators take 1. ``angle_rms``, ``angle_max`` mechanical [deg];
    ``speed_rms``, and ``moving`` of it beyond 5 rad/s [rad/s]; ``standstill``: worst drift within a second of rest
    [deg]; ``fast``: drift within 50 ms above 20 rad/s, rms [deg]; ``note``: angle rms of the research note, 1 ms.
    """

    estimator: str
    period_ms: float
    voltages: str
    resistance: float
    seeds: int
    angle_rms: float
    angle_max: float
    speed_rms: float
    moving: float
    standstill: float
    fast: float
    note: float


#: Seed, period [s], voltages as means, factor of the resistance.
Job = tuple[int, float, bool, float]


def _drift(error: Array, steps: int, within: NDArray[np.bool_]) -> Array:
    """Return what an error changes by in so many steps, of those spans in which all samples are ``within``."""
    all_of = np.convolve(~within, np.ones(steps + 1), "valid") == 0
    return np.asarray(np.abs(error[steps:] - error[:-steps])[all_of])


def _work(job: Job) -> list[tuple[Job, list[tuple[float, ...]]]]:
    seed, period, mean_dq, resistance = job
    x = nominal(seed, period, resistance)
    out = estimate(x, period, mean_dq=mean_dq)
    rows: list[tuple[float, ...]] = []
    moves = np.abs(x["omega"]) > 5.0
    n = len(NAMES)
    for j in range(n):
        angle = np.degrees(out[:, j] - x["theta"])
        speed = out[:, n + j] - x["omega"]
        fast = _drift(angle, round(0.05 / period), np.abs(x["omega"]) > 20.0)
        rows.append(
            (
                float(np.sqrt(np.mean(angle**2))),
                float(np.abs(angle).max()),
                float(np.sqrt(np.mean(speed**2))),
                float(np.sqrt(np.mean(speed[moves] ** 2))),
                float(_drift(angle, round(1.0 / period) - 1, ~moves).max(initial=0.0)),
                float(np.sqrt(np.mean(fast**2))),
            )
        )
    return [(job, rows)]


def jobs(seeds: int) -> list[Job]:
    """Return the jobs of :func:`accuracy`: 1 ms, nominal and warm, with means of the voltages, then 2 and 5 ms."""
    forms = ((1e-3, False, 1.0), (1e-3, False, WARM), (1e-3, True, 1.0), (2e-3, True, 1.0), (5e-3, True, 1.0))
    return [(seed, *form) for form in forms for seed in range(seeds)]


def accuracy(job_list: list[Job], progress: Progress = lambda: None) -> list[Accuracy]:
    """Return the errors of all estimators, a row for each form of samples."""
    if not job_list:
        return []
    _work(job_list[0])  # fills the kernels' cache before several processes want it
    groups: dict[tuple[float, bool, float], list[Any]] = {}
    for job, rows in run(_work, job_list, progress):
        groups.setdefault(job[1:], []).append(rows)
    found = []
    for (period, mean, resistance), rows in groups.items():
        means = np.mean(np.array(rows), axis=0)
        for name, note, values in zip(NAMES, NOTE, means, strict=True):
            rms, most, speed, moving, standstill, fast = map(float, values)
            found.append(
                Accuracy(
                    estimator=name,
                    period_ms=1e3 * period,
                    voltages="dq" if mean else "alpha beta",
                    resistance=resistance,
                    seeds=len(rows),
                    angle_rms=rms,
                    angle_max=most,
                    speed_rms=speed,
                    moving=moving,
                    standstill=standstill,
                    fast=fast,
                    note=note if (period, mean, resistance) == (1e-3, False, 1.0) else float("nan"),
                )
            )
    return found
