"""A PM motor with its inverter. Plant: inductances that saturate, dead time, windings and magnets that warm, control.

The model has constant inductances, no dead time, and one heat capacity. Parameters are up to 6 % off. A fault of a
sensor that the control reads moves the motor.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from foreign.plant import Array, Plant, all_of, course, shown
from numba import njit

from gateway_plants.structural.study.model_text import written

NAMES = ("f_R", "f_psi", "f_cool", "f_id", "f_iq", "f_w", "f_Tc", "f_tl")
NOMINAL = {
    "R0": 0.05, "Ld": 4e-4, "Lq": 8e-4, "psi": 0.06, "J": 0.02, "b": 0.005, "C": 200.0, "G": 3.0, "Ta": 40.0,
}  # fmt: skip
OFF = dict.fromkeys(NOMINAL, 0.06) | {"Ta": 0.02}
PERIOD_S, STEPS = 0.01, 10


@njit(cache=True)
def _solved(wanted, load, p, f):
    """Return voltages, currents, speed and temperature at each sample, by steps of Euler's method of 1 ms."""
    r0, ld, lq, psi, j, b, heat, cooled, ambient = p
    found, h = np.zeros((len(load), 6)), PERIOD_S / STEPS
    i_d = i_q = total = 0.0
    w, hot, magnets = wanted[0], ambient, ambient
    for k in range(-500, len(load)):
        n = max(k, 0)
        for step in range(STEPS):
            error = wanted[n] - w - f[n, 5]
            total = min(max(total + 5.0 * error * h, -120.0), 120.0)
            asked = min(max(0.5 * error + total, -150.0), 150.0)
            slope_d = (-8.0 - 0.25 * abs(asked) - i_d - f[n, 3]) / 5e-3
            slope_q = (asked - i_q - f[n, 4]) / 5e-3
            flux = psi * (1.0 + f[n, 1]) * (1.0 - 1e-3 * (magnets - ambient))
            lq_now, ld_now = lq * (1.0 - 8e-4 * abs(i_q)), ld * (1.0 - 3e-4 * abs(i_d))
            ohm = r0 * (1.0 + f[n, 0]) * (1.0 + 0.0039 * (hot - 25.0))
            if step == 0 and k >= 0:
                amps, dead = np.hypot(i_d, i_q) + 5.0, 0.2
                found[k, 0] = ohm * i_d + ld_now * slope_d - 4.0 * w * lq_now * i_q + dead * i_d / amps
                found[k, 1] = ohm * i_q + lq_now * slope_q + 4.0 * w * (ld_now * i_d + flux) + dead * i_q / amps
                found[k, 2:] = i_d, i_q, w, hot
            torque = 6.0 * (flux + (ld_now - lq_now) * i_d) * i_q
            w += h * (torque - b * w - 1e-5 * w * w - load[n]) / j
            loss = 1.5 * ohm * (i_d * i_d + i_q * i_q)
            hot += h * (loss + 1e-4 * w * w - cooled * (1.0 + f[n, 2]) * (hot - ambient)) / heat if k >= 0 else 0.0
            magnets += h * (hot - magnets) / 150.0
            i_d, i_q = i_d + h * slope_d, i_q + h * slope_q
    return found


def drive(seed: int, count: int, faults: Mapping[str, Array]) -> Array:
    """Return what the sensors and commands are."""
    rng, motor = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    p = np.array([value * (1.0 + motor.uniform(-OFF[k], OFF[k])) for k, value in NOMINAL.items()])
    wanted = course(rng, count, PERIOD_S, 60.0, 300.0, (4, 12))
    load = course(rng, count, PERIOD_S, 5.0, 30.0, (3, 9))
    f = all_of(faults, NAMES, count)
    x = _solved(wanted, load, p, f)
    return np.stack([
        np.round(x[:, 0], 2), np.round(x[:, 1], 2),
        shown(rng, motor, x[:, 2] + f[:, 3], (0.005, 0.2, 0.3, 0.1)),
        shown(rng, motor, x[:, 3] + f[:, 4], (0.005, 0.2, 0.3, 0.1)),
        shown(rng, motor, x[:, 4] + f[:, 5], (0.0, 0.0, 0.3, 0.1)),
        shown(rng, motor, x[:, 5] + f[:, 6], (0.0, 1.0, 0.3, 0.1)),
        shown(rng, motor, load + f[:, 7], (0.005, 0.1, 0.1, 0.05)),
    ], 1)  # fmt: skip


MOTOR = Plant(
    "motor",
    written(
        unknown=dict.fromkeys(("Id", "Iq", "w", "R", "Tc", "Tl", "Psi"), ""),
        known=("u_d", "u_q", "y_id", "y_iq", "y_w", "y_Tc", "y_tl"),
        faults={
            "f_R": "winding", "f_psi": "magnets", "f_cool": "cooling", "f_id": "sensor of the current d",
            "f_iq": "sensor of the current q", "f_w": "speed sensor", "f_Tc": "temperature sensor",
            "f_tl": "torque sensor",
        },
        parameters=NOMINAL,
        e1=("u_d = R * Id - 4 * w * Lq * Iq", "Iq"),
        e2=("u_q = R * Iq + 4 * w * (Ld * Id + Psi)", "w Psi"),
        e3=("J * der(w) = 6 * (Psi + (Ld - Lq) * Id) * Iq - b * w - Tl", "der(w) Tl"),
        e4=("R = R0 * (1 + f_R) * (1 + 0.0039 * (Tc - 25))", "R"),
        e5=("C * der(Tc) = 1.5 * R * (Id ** 2 + Iq ** 2) - G * (1 + f_cool) * (Tc - Ta)", "der(Tc)"),
        e6=("Psi = psi * (1 + f_psi)", "Psi"),
        e7=("y_id = Id + f_id", "Id"),
        e8=("y_iq = Iq + f_iq", "Iq"),
        e9=("y_w = w + f_w", "w"),
        e10=("y_Tc = Tc + f_Tc", "Tc"),
        e11=("y_tl = Tl + f_tl", "Tl"),
    ),
    PERIOD_S,
    ("u_d", "u_q", "y_id", "y_iq", "y_w", "y_Tc", "y_tl"),
    """start = { w = 100.0, Tc = 40.0 }
settle_s = 3
confirm_s = 1
uncertain = { R0 = "10 %", Ld = "10 %", Lq = "10 %", psi = "10 %", J = "10 %", b = "15 %", C = "10 %", G = "10 %" }
sensors.y_id = { gain = "1 %", bias = 0.4 }
sensors.y_iq = { gain = "1 %", bias = 0.4 }
sensors.y_Tc = { bias = 2.0 }
sensors.y_tl = { gain = "1 %", bias = 0.2 }
""",
    {
        "f_R": (0.6, 0.4), "f_psi": (-0.3, -0.2), "f_cool": (-0.8, -0.6), "f_id": (20.0, -15.0),
        "f_iq": (12.0, -10.0), "f_w": (25.0, -15.0), "f_Tc": (25.0, -20.0), "f_tl": (8.0, -6.0),
    },
    {"f_id": "y_id", "f_iq": "y_iq", "f_w": "y_w", "f_Tc": "y_Tc", "f_tl": "y_tl"},
    drive,
)  # fmt: skip
