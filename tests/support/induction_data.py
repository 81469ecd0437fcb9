"""The induction motor of Fault Diagnosis Toolbox, its equations integrated by SciPy, and on a bus.

The equations are written down here once more, not read from the model. Its load is not known to the model; here it is
what lets the motor turn as `speed` says. (With the signs of the toolbox the flux grows where that is beyond c.)
"""

import numpy as np
from scipy.integrate import solve_ivp

from gateway.bus.frames import empty, put

A, B, C, D, L_M = 200.0, 20.0, 8.0, 70.0, 0.2
#: Time between two samples [s].
DT = 1e-3
DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 Voltages: 4 A
 SG_ Ua : 0|16@1- (0.001,0) [-32|32] "V" A
 SG_ Ub : 16|16@1- (0.001,0) [-32|32] "V" A
BO_ 257 Sensors: 6 A
 SG_ Ia : 0|16@1- (0.001,0) [-32|32] "A" A
 SG_ Ib : 16|16@1- (0.001,0) [-32|32] "A" A
 SG_ Speed : 32|16@1- (0.001,0) [-32|32] "rad/s" A
"""


def speed(t):
    return 3.0 + np.sin(0.8 * t)


def voltages(t):
    return 10.0 * np.cos(2.0 * np.pi * t), 10.0 * np.sin(2.0 * np.pi * t)


def _slope(t, x):
    i_a, i_b, lambda_a, lambda_b = x
    w, (u_a, u_b) = speed(t), voltages(t)
    q_a, q_b = w * lambda_a, w * lambda_b
    return (
        -A * i_a + B * C * lambda_a + B * q_b + D * u_a,
        -A * i_b + B * C * lambda_b + B * q_a + D * u_b,
        L_M * C * i_a - C * lambda_a - q_b,
        L_M * C * i_b - C * lambda_b - q_a,
    )


def drive(seconds, *, seed, onset=0.0, f_a=0.0, f_b=0.0):
    """u_a, u_b, y1, y2, y3 of each sample, shape (samples, 5)."""
    times = np.arange(round(seconds / DT)) * DT
    found = solve_ivp(_slope, (0.0, times[-1]), np.zeros(4), t_eval=times, rtol=1e-8, atol=1e-10, max_step=0.02)
    assert found.success
    there = times >= onset
    rows = np.stack([*voltages(times), found.y[0] + there * f_a, found.y[1] + there * f_b, speed(times)], 1)
    return rows + np.random.default_rng(seed).normal(size=rows.shape) * (0.0, 0.0, 0.02, 0.02, 0.01)


def frames_of(rows, *, begin_ns=10**9):
    """The frames of samples: voltages, and 0.1 ms behind them the sensors."""
    codes = np.round(rows * 1000.0).astype("<i2")
    frames = empty(2 * len(rows))
    for n, row in enumerate(codes):
        stamp = begin_ns + round(n * DT * 1e9)
        put(frames, 2 * n, stamp, 256, row[:2].tobytes(), bus=0)
        put(frames, 2 * n + 1, stamp + 100_000, 257, row[2:].tobytes(), bus=0)
    return frames
