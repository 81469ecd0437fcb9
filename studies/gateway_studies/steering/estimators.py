"""All estimators on one run: the paper's four, and the ones with the angle as a state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.fdi.filters import ekf_alpha_beta, ekf_dq, feedforward, luenberger, reduced_luenberger
from gateway.fdi.filters.motor import Motor
from gateway.fdi.filters.transforms import clarke, park
from gateway.jit import kernel, zeros
from gateway.vecu.steering.course import sweep, times
from gateway.vecu.steering.plant import Plant, drive, undisturbed
from gateway_studies.pool import Progress, run
from gateway_studies.steering.cases import DURATION

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
LO, REDUCED, EKF3, EKF4_DQ, EKF3_OWN, FF, FF_HELD, FF_PRINTED, EKF4_AB, EKF5_AB, ANCHORED = range(
    11
)
#: Further column behind the angles and the speeds: normalised innovation squared of EKF4 dq.
NIS = 2 * len(NAMES)
COLUMNS = NIS + 1

#: What the research note has, on a set-up of which it does not give every time: angle rms, mechanical [deg].
NOTE = (521.0, 318.0, 133.0, 6.1, 141.0, 671.0, 124.0, 1170.0, 2.2, 1.24, float("nan"))


@kernel
def _estimate(
    x: Any,
    z: float,
    mean_dq: int,
    lo: Any,
    lo_c: Any,
    red: Any,
    red_c: Any,
    e3: Any,
    e3_c: Any,
    e4: Any,
    e4_c: Any,
    own: Any,
    f1: Any,
    f1_c: Any,
    f2: Any,
    f2_c: Any,
    f3: Any,
    f3_c: Any,
    a4: Any,
    a4_c: Any,
    a5: Any,
    a5_c: Any,
    held: Any,
    held_c: Any,
    out: Any,
) -> None:
    n = (out.shape[1] - 1) // 2
    last = z * x[0].sensor
    ekf_alpha_beta.begin(a4, a4_c, x[0].sensor)
    ekf_alpha_beta.begin(a5, a5_c, x[0].sensor)
    ekf_alpha_beta.begin(held, held_c, x[0].sensor)
    for k in range(x.shape[0]):
        m = x[k]
        theta = z * m.sensor
        i_a, i_b = clarke(m.i_u, m.i_v)
        i_d, i_q = park(i_a, i_b, theta)
        u_a, u_b = m.u_alpha, m.u_beta
        frame, turned = 0.0, 0.0
        u_d, u_q = park(u_a, u_b, 0.5 * (theta + last))
        u_1, u_2 = u_a, u_b
        if mean_dq == 1:
            u_d, u_q = m.u_d, m.u_q
            u_1, u_2, frame, turned = u_d, u_q, last, theta - last
        luenberger.step(lo, lo_c, u_q, i_q)
        reduced_luenberger.step(red, red_c, u_q, i_q)
        ekf_dq.step(e3, e3_c, u_d, u_q, i_d, i_q)
        ekf_dq.step(e4, e4_c, u_d, u_q, i_d, i_q)
        believed = z * own.theta
        o_d, o_q = park(u_a, u_b, believed)
        ekf_dq.predict(own, e3_c, o_d, o_q)
        o_d, o_q = park(i_a, i_b, z * own.theta)
        ekf_dq.correct(own, e3_c, o_d, o_q)
        feedforward.step(f1, f1_c, u_a, u_b, i_a, i_b)
        feedforward.step(f2, f2_c, u_a, u_b, i_a, i_b)
        feedforward.step(f3, f3_c, u_a, u_b, i_a, i_b)
        ekf_alpha_beta.step(a4, a4_c, u_1, u_2, frame, turned, i_a, i_b)
        ekf_alpha_beta.step(a5, a5_c, u_1, u_2, frame, turned, i_a, i_b)
        ekf_alpha_beta.step(held, held_c, u_1, u_2, frame, turned, i_a, i_b)
        ekf_alpha_beta.hold(held, held_c, m.sensor, 1.0)
        last = theta
        r = out[k]
        r[0], r[n] = lo.theta, lo.omega
        r[1], r[n + 1] = red.theta, red.omega
        r[2], r[n + 2] = e3.theta, e3.x[2]
        r[3], r[n + 3] = e4.theta, e4.x[2]
        r[4], r[n + 4] = own.theta, own.x[2]
        # The EMF is that of the middle of the step.
        half = 0.5 * a5.x[2] * a5_c.h * a5_c.steps
        r[5], r[n + 5] = f1.theta + half, a5.x[2]
        r[6], r[n + 6] = f2.theta + half, a5.x[2]
        r[7], r[n + 7] = f3.theta + half, a5.x[2]
        r[8], r[n + 8] = a4.x[3], a4.x[2]
        r[9], r[n + 9] = a5.x[3], a5.x[2]
        r[10], r[n + 10] = held.x[3], held.x[2]
        r[2 * n] = e4.nis


def estimate(samples: NDArray[np.void], period: float, *, mean_dq: bool = False) -> Array:
    """Run all estimators over samples, shape (n,) of SAMPLE.

    Args:
        samples: of the plant.
        period: of the samples [s].
        mean_dq: voltages as means in the controller's frame, as the bus has them; else in the stator's.

    Returns:
        shape (n, 23): angles [rad] and speeds [rad/s] in the order of :data:`NAMES`, then EKF4 dq's NIS.
    """
    m = Motor()
    parts: list[Any] = []

    def add(module: Any, constants: bool = True, **options: Any) -> None:
        parts.append(zeros(1, module.State)[0])
        if constants:
            c = zeros(1, module.Const)
            module.prepare(c[0], m, period, **options)
            parts.append(c[0])

    add(luenberger)
    add(reduced_luenberger)
    add(ekf_dq, load=False, voltage=0.02, torque=1.2, current=0.1)
    add(ekf_dq, load=True)
    add(ekf_dq, constants=False)
    add(feedforward, held=0.0)
    add(feedforward)
    add(feedforward, held=0.0, printed=True)
    add(ekf_alpha_beta, load=False, voltage=0.0114, torque=1.35, current=0.44, slow=0.0)
    add(ekf_alpha_beta, slow=0.0)
    add(ekf_alpha_beta)
    for at in (9, 11, 13):  # the feed-forward filters begin at the sensor's angle
        parts[at]["theta_e"] = m.pole_pairs * samples["sensor"][0]
    x = zeros(len(samples), samples.dtype)
    x[:] = samples
    out = np.zeros((len(samples), COLUMNS))
    everything: Any = _estimate
    everything(x, float(m.pole_pairs), int(mean_dq), *parts, out)
    return out


def nominal(seed: int, period: float) -> NDArray[np.void]:
    """Return the study's course with the nominal motor and all its noise."""
    course = sweep(times(DURATION))
    wrong = undisturbed(len(course.motor))
    rng = np.random.default_rng(seed)
    return drive(Plant(), course.motor, course.load, wrong, rng, period)


@dataclass
class Accuracy:
    """Errors of an estimator, means over the seeds.

    ``angle_rms``, ``angle_max`` mechanical [deg]; ``speed_rms``, and ``moving`` of it beyond 5 rad/s [rad/s];
    ``standstill``: worst drift within a second of rest [deg]; ``note``: angle rms of the research note, 1 ms.
    """

    estimator: str
    period_ms: float
    voltages: str
    seeds: int
    angle_rms: float
    angle_max: float
    speed_rms: float
    moving: float
    standstill: float
    note: float


Job = tuple[int, float, bool]


def _work(job: Job) -> list[tuple[Job, list[tuple[float, float, float, float, float]]]]:
    seed, period, mean_dq = job
    x = nominal(seed, period)
    out = estimate(x, period, mean_dq=mean_dq)
    rows = []
    moves = np.abs(x["omega"]) > 5.0
    second = round(1.0 / period)
    still = np.convolve(moves, np.ones(second), "valid") == 0
    n = len(NAMES)
    for j in range(n):
        angle = np.degrees(out[:, j] - x["theta"])
        speed = out[:, n + j] - x["omega"]
        drifted = np.abs(angle[second - 1 :] - angle[: len(angle) - second + 1])[still]
        rows.append(
            (
                float(np.sqrt(np.mean(angle**2))),
                float(np.abs(angle).max()),
                float(np.sqrt(np.mean(speed**2))),
                float(np.sqrt(np.mean(speed[moves] ** 2))),
                float(drifted.max(initial=0.0)),
            )
        )
    return [(job, rows)]


def jobs(seeds: int) -> list[Job]:
    """Return the jobs of :func:`accuracy`: 1 ms in both forms of the voltages, then 2 and 5 ms."""
    forms = ((1e-3, False), (1e-3, True), (2e-3, True), (5e-3, True))
    return [(seed, period, mean) for period, mean in forms for seed in range(seeds)]


def accuracy(job_list: list[Job], progress: Progress = lambda: None) -> list[Accuracy]:
    """Return the errors of all estimators, a row for each form of samples."""
    if not job_list:
        return []
    _work(job_list[0])  # fills the kernels' cache before several processes want it
    groups: dict[tuple[float, bool], list[Any]] = {}
    for job, rows in run(_work, job_list, progress):
        groups.setdefault(job[1:], []).append(rows)
    found = []
    for (period, mean), rows in groups.items():
        means = np.mean(np.array(rows), axis=0)
        for name, note, values in zip(NAMES, NOTE, means, strict=True):
            rms, most, speed, moving, standstill = map(float, values)
            found.append(
                Accuracy(
                    estimator=name,
                    period_ms=1e3 * period,
                    voltages="dq" if mean else "alpha beta",
                    seeds=len(rows),
                    angle_rms=rms,
                    angle_max=most,
                    speed_rms=speed,
                    moving=moving,
                    standstill=standstill,
                    note=note if period == 1e-3 and not mean else float("nan"),
                )
            )
    return found
