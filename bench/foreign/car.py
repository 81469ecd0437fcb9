"""Lateral dynamics of a car. Plant: tyres that saturate and need a way to build up force, roll, a bank of the road.

The model is a single track with tyres that are lines. Parameters are up to 8 % off.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from foreign.plant import Array, Plant, all_of, course, shown
from numba import njit

from gateway_plants.structural.study.model_text import written

NAMES = ("f_d", "f_r", "f_ay", "f_rl", "f_rr", "f_Cf", "f_Cr")
NOMINAL = {"m": 1550.0, "Iz": 2500.0, "a": 1.15, "b": 1.55, "Cf": 95e3, "Cr": 120e3, "tw": 1.53, "iS": 15.2}
#: By how much each is off; lengths are known better.
OFF = {"m": 0.08, "Iz": 0.08, "a": 0.024, "b": 0.024, "Cf": 0.08, "Cr": 0.08, "tw": 0.01, "iS": 0.01}
PERIOD_S, STEPS, DEGREES = 0.02, 10, 180.0 / np.pi


@njit(cache=True)
def _slopes(x, d, v, bank, p, worn_f, worn_r):
    """Of lateral speed, yaw rate, forces of both axles, roll."""
    m, iz, a, b, cf, cr = p[:6]
    grip = 0.95 * m * 9.81 / (a + b)
    af, ar = d - (x[0] + a * x[1]) / v, -(x[0] - b * x[1]) / v
    ff = grip * b * np.sin(1.3 * np.arctan(cf * (1.0 + worn_f) * af / (1.3 * grip * b)))
    fr = grip * a * np.sin(1.3 * np.arctan(cr * (1.0 + worn_r) * ar / (1.3 * grip * a)))
    ay = (x[2] + x[3]) / m
    return np.array([
        ay - 9.81 * bank - v * x[1], (a * x[2] - b * x[3]) / iz, (ff - x[2]) * v / 0.5, (fr - x[3]) * v / 0.5,
        (0.0065 * ay - x[4]) / 0.12,
    ])  # fmt: skip


@njit(cache=True)
def _solved(d, v, bank, p, worn):
    """Return the states and the acceleration at each sample, by Heun's method."""
    found, x, h = np.zeros((len(d), 6)), np.zeros(5), PERIOD_S / STEPS
    for k in range(len(d)):
        found[k, :5], found[k, 5] = x, (x[2] + x[3]) / p[0]
        for _ in range(STEPS):
            one = _slopes(x, d[k], v[k], bank[k], p, worn[k, 0], worn[k, 1])
            x = x + 0.5 * h * (one + _slopes(x + h * one, d[k], v[k], bank[k], p, worn[k, 0], worn[k, 1]))
    return found


def drive(seed: int, count: int, faults: Mapping[str, Array]) -> Array:
    """Return what the sensors show: steering wheel, yaw rate, acceleration, rear wheels."""
    rng, car = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    p = np.array([value * (1.0 + car.uniform(-OFF[k], OFF[k])) for k, value in NOMINAL.items()])
    v = course(rng, count, PERIOD_S, 8.0, 33.0, (6, 18))
    turning = course(rng, count, PERIOD_S, 0.0, 1.0, (4, 12)) ** 2
    phase = np.cumsum(course(rng, count, PERIOD_S, 0.15, 0.9, (3, 6))) * PERIOD_S * 2.0 * np.pi
    hand = np.minimum(3.2 / (v * v / (2.7 * (1.0 + 0.002 * v * v))) * DEGREES * 15.2, 200.0) * turning
    hand = hand * (np.sin(phase) + 0.3 * np.sin(0.37 * phase + 1.0))
    bank = course(rng, count, PERIOD_S, -0.02, 0.02, (10, 30))
    f = all_of(faults, NAMES, count)
    x = _solved(hand / DEGREES / p[7], v, bank, p, f[:, 5:])
    yaw, half, radii = x[:, 1], 0.5 * p[6] * x[:, 1], 1.0 + car.normal(0.0, 0.0012, 2)
    return np.stack([
        shown(rng, car, hand + f[:, 0], (0.0, 1.4, 0.05, 0.1)),
        shown(rng, car, np.roll(yaw * DEGREES, 1) + f[:, 1], (0.008, 0.15, 0.08, 0.01)),
        shown(rng, car, np.roll(x[:, 5] + 9.81 * x[:, 4], 1) + f[:, 2], (0.0, 0.08, 0.05, 0.005)),
        shown(rng, car, 3.6 * (v - half) * radii[0] + f[:, 3], (0.0, 0.0, 0.03, 0.01)),
        shown(rng, car, 3.6 * (v + half) * radii[1] + f[:, 4], (0.0, 0.0, 0.03, 0.01)),
    ], 1)  # fmt: skip


CAR = Plant(
    "car",
    written(
        unknown={"Ff": "N", "Fr": "N", "vy": "m/s", "r": "rad/s", "d": "rad", "v": "m/s", "ay": "m/s2"},
        known=("y_d", "y_r", "y_ay", "y_rl", "y_rr"),
        faults={
            "f_d": "steering angle sensor", "f_r": "yaw rate sensor", "f_ay": "acceleration sensor",
            "f_rl": "rear left wheel speed sensor", "f_rr": "rear right wheel speed sensor", "f_Cf": "front tyres",
            "f_Cr": "rear tyres",
        },
        parameters=NOMINAL,
        e1=("Ff = Cf * (1 + f_Cf) * (d - (vy + a * r) / v)", "Ff d vy r"),
        e2=("Fr = - Cr * (1 + f_Cr) * (vy - b * r) / v", "Fr vy r"),
        e3=("m * (der(vy) + v * r) = Ff + Fr", "der(vy) r Ff Fr"),
        e4=("Iz * der(r) = a * Ff - b * Fr", "der(r) Ff Fr"),
        e5=("m * ay = Ff + Fr", "ay Ff Fr"),
        e6=("y_d = 57.29578 * iS * d + f_d", "d"),
        e7=("y_r = 57.29578 * r + f_r", "r"),
        e8=("y_ay = ay + f_ay", "ay"),
        e9=("y_rl = 3.6 * (v - 0.5 * tw * r) + f_rl", "v r"),
        e10=("y_rr = 3.6 * (v + 0.5 * tw * r) + f_rr", "v r"),
    ),
    PERIOD_S,
    ("y_d", "y_r", "y_ay", "y_rl", "y_rr"),
    """start = { vy = 0.0, r = 0.0 }
settle_s = 5
confirm_s = 1
active = "y_rl > 20 and y_rr > 20"
uncertain = { m = "12 %", Iz = "12 %", Cf = "15 %", Cr = "15 %" }
sensors.y_d = { bias = 2.0 }
sensors.y_r = { gain = "1.5 %", bias = 0.3 }
sensors.y_ay = { gain = "12 %", bias = 0.3 }
sensors.y_rl = { gain = "0.5 %" }
sensors.y_rr = { gain = "0.5 %" }
""",
    {
        "f_d": (12.0, 5.0, -5.0), "f_r": (3.0, 1.2, -2.0), "f_ay": (1.2, 0.6, -0.8), "f_rl": (2.5, 1.0, -1.5),
        "f_rr": (2.5, 1.0, -1.5), "f_Cf": (-0.45, -0.3), "f_Cr": (-0.45, -0.3),
    },
    {"f_d": "y_d", "f_r": "y_r", "f_ay": "y_ay", "f_rl": "y_rl", "f_rr": "y_rr"},
    drive,
)  # fmt: skip
