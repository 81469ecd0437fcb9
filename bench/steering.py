"""Time of a step of the motor's estimators, beside filterpy's class and NumPy, in one run.

python bench/steering.py [--steps 200000] [--json]
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.filters import ekf_alpha_beta, feedforward
from gateway_fdi.filters.motor import Motor
from gateway_fdi.filters.transforms import clarke, park
from gateway_fdi.jit import kernel, zeros
from gateway_plants.steering.study.estimators import nominal
from gateway_plants.steering.study.filters import ekf_dq, luenberger, reduced_luenberger

REPEATS = 5
M, T = Motor(), 1e-3


@kernel
def run_luenberger(s, c, x):
    for k in range(x.shape[0]):
        i_a, i_b = clarke(x[k].i_u, x[k].i_v)
        _, u_q = park(x[k].u_alpha, x[k].u_beta, 4.0 * x[k].sensor)
        _, i_q = park(i_a, i_b, 4.0 * x[k].sensor)
        luenberger.step(s, c, u_q, i_q)


@kernel
def run_reduced(s, c, x):
    for k in range(x.shape[0]):
        i_a, i_b = clarke(x[k].i_u, x[k].i_v)
        _, u_q = park(x[k].u_alpha, x[k].u_beta, 4.0 * x[k].sensor)
        _, i_q = park(i_a, i_b, 4.0 * x[k].sensor)
        reduced_luenberger.step(s, c, u_q, i_q)


@kernel
def run_dq(s, c, x):
    for k in range(x.shape[0]):
        i_a, i_b = clarke(x[k].i_u, x[k].i_v)
        u_d, u_q = park(x[k].u_alpha, x[k].u_beta, 4.0 * x[k].sensor)
        i_d, i_q = park(i_a, i_b, 4.0 * x[k].sensor)
        ekf_dq.step(s, c, u_d, u_q, i_d, i_q)


@kernel
def run_ab(s, c, x):
    for k in range(x.shape[0]):
        i_a, i_b = clarke(x[k].i_u, x[k].i_v)
        ekf_alpha_beta.step(s, c, x[k].u_alpha, x[k].u_beta, 0.0, 0.0, i_a, i_b)


@kernel
def run_forward(s, c, x):
    for k in range(x.shape[0]):
        i_a, i_b = clarke(x[k].i_u, x[k].i_v)
        feedforward.step(s, c, x[k].u_alpha, x[k].u_beta, i_a, i_b)


def kernel_us(module, run, x, **options):
    """Best of some repeats [us a step]."""
    c, s = zeros(1, module.Const), zeros(1, module.State)
    module.prepare(c[0], M, T, **options)
    run(s[0], c[0], x[:100])
    best = np.inf
    for _ in range(REPEATS):
        begun = time.perf_counter()
        run(s[0], c[0], x)
        best = min(best, time.perf_counter() - begun)
    return best / len(x) * 1e6


def model(x, u, h):
    """Euler step and Jacobian of EKF3 dq, in NumPy."""
    i_d, i_q, w = x
    z, r, ind, j, b = M.pole_pairs, M.resistance, M.ld, M.inertia, M.friction
    slope = np.array(
        [
            (u[0] - r * i_d + z * w * ind * i_q) / ind,
            (u[1] - r * i_q - z * w * (ind * i_d + M.flux)) / ind,
            (M.torque * i_q - b * w) / j,
        ]
    )
    jac = np.array(
        [
            [1 - h * r / ind, h * z * w, h * z * i_q],
            [-h * z * w, 1 - h * r / ind, -h * z * (M.flux + ind * i_d) / ind],
            [0.0, h * M.torque / j, 1 - h * b / j],
        ]
    )
    return x + h * slope, jac


class Ekf3(ExtendedKalmanFilter):
    """filterpy's class with a step of the motor; one Euler step."""

    def predict_x(self, u=0):
        self.x, self.F = model(self.x, u, T)


def filterpy_us(rows):
    kf = Ekf3(dim_x=3, dim_z=2)
    kf.x = np.zeros(3)
    kf.Q, kf.R = np.diag([0.1, 0.1, 1.0]), np.eye(2) * 0.04
    h = np.eye(2, 3)
    begun = time.perf_counter()
    for row in rows:
        theta = 4.0 * row["sensor"]
        i_a, i_b = row["i_u"], (row["i_u"] + 2 * row["i_v"]) / np.sqrt(3)
        c, s = np.cos(theta), np.sin(theta)
        u = np.array([row["u_alpha"] * c + row["u_beta"] * s, row["u_beta"] * c - row["u_alpha"] * s])
        kf.predict(u)
        kf.update(np.array([i_a * c + i_b * s, i_b * c - i_a * s]), lambda _: h, lambda x: h @ x)
    return (time.perf_counter() - begun) / len(rows) * 1e6


def numpy_us(rows):
    x, p = np.zeros(3), np.eye(3)
    q, r, h = np.diag([0.1, 0.1, 1.0]), np.eye(2) * 0.04, np.eye(2, 3)
    begun = time.perf_counter()
    for row in rows:
        theta = 4.0 * row["sensor"]
        i_a, i_b = row["i_u"], (row["i_u"] + 2 * row["i_v"]) / np.sqrt(3)
        c, s = np.cos(theta), np.sin(theta)
        u = np.array([row["u_alpha"] * c + row["u_beta"] * s, row["u_beta"] * c - row["u_alpha"] * s])
        y = np.array([i_a * c + i_b * s, i_b * c - i_a * s])
        x, f = model(x, u, T)
        p = f @ p @ f.T + q
        k = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
        x = x + k @ (y - h @ x)
        p = p - k @ h @ p
    return (time.perf_counter() - begun) / len(rows) * 1e6


def gateway_us():
    """The whole way of a frame of the bus: decode, counter, CRC, monitor, its own message [us]."""
    scenario = load_scenario(shipped("scenarios/steering_healthy.toml"))
    config = load_config(scenario.config)
    frames = Player(scenario, {"chassis": 0}).frames
    best = np.inf
    for _ in range(REPEATS):
        gateway = Gateway(config)
        gateway.start(0)
        begun = time.perf_counter()
        gateway.feed(frames)
        best = min(best, time.perf_counter() - begun)
        gateway.close()
    return best / len(frames) * 1e6, scenario.duration_s / best


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    samples = nominal(1, T)
    repeats = max(options.steps // len(samples), 1)
    x = zeros(len(samples) * repeats, samples.dtype)
    x[:] = np.tile(samples, repeats)
    few = samples[:3000]
    filterpy_us(few[:300])
    times = {
        "filterpy, EKF3 dq, 1 sub-step": filterpy_us(few),
        "NumPy, EKF3 dq, 1 sub-step": numpy_us(few),
        "Luenberger": kernel_us(luenberger, run_luenberger, x),
        "reduced Luenberger": kernel_us(reduced_luenberger, run_reduced, x),
        "feedforward": kernel_us(feedforward, run_forward, x),
        "EKF3 dq, 1 sub-step": kernel_us(ekf_dq, run_dq, x, load=False, steps=1),
        "EKF3 dq, 8 sub-steps": kernel_us(ekf_dq, run_dq, x, load=False),
        "EKF4 dq + load, 8 sub-steps": kernel_us(ekf_dq, run_dq, x, load=True),
        "EKF4 ab, 8 sub-steps": kernel_us(ekf_alpha_beta, run_ab, x, load=False),
        "EKF5 ab, 1 sub-step": kernel_us(ekf_alpha_beta, run_ab, x, steps=1),
        "EKF5 ab, 8 sub-steps": kernel_us(ekf_alpha_beta, run_ab, x),
    }
    peer = times["filterpy, EKF3 dq, 1 sub-step"]
    rows = [{"name": name, "us": us, "ratio": peer / us, "against": "filterpy"} for name, us in times.items()]
    us, speed = gateway_us()
    rows.append({"name": "whole gateway, a frame", "us": us, "ratio": peer / us, "against": "filterpy"})
    if options.json:
        print(json.dumps({"rows": rows, "times_real_time": speed}))
        return
    for row in rows:
        print(f"{row['name']:32s} {row['us']:9.4f} us a step  {row['ratio']:9.1f} x filterpy")
    print(f"the steering's bus is replayed at {speed:.0f} x real time")


if __name__ == "__main__":
    main()
