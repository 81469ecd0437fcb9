"""A turbo engine's air path. Plant: an isentropic throttle, valves by speed and pressure, a turbo whose lag varies.

The model has an ellipse for the throttle, one volumetric efficiency and one lag. Parameters are up to 5 % off. Flows
are in g/s, pressures in kPa, the turbo's speed in 1000 / min.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from foreign.plant import Array, Plant, all_of, course, shown
from numba import njit

from gateway_plants.structural.study.model_text import written

NAMES = ("f_thr", "f_vol", "f_wg", "f_leak", "f_waf", "f_pim", "f_pic", "f_wt")
NOMINAL = {
    "kv": 1.6e-4, "kt": 5.6, "kc": 7e-5, "kq": 0.4, "kg": 1.4, "w0": 30.0, "tau": 0.6, "vim": 0.045, "vic": 0.1,
    "p0": 100.0,
}  # fmt: skip
OFF = dict.fromkeys(NOMINAL, 0.05) | {"p0": 0.002, "w0": 0.02, "vim": 0.02, "vic": 0.02}
PERIOD_S, STEPS = 0.01, 10


@njit(cache=True)
def _slopes(x, u, n, wg, p, f):
    """Return those of both pressures and the turbo's speed, and the compressor's flow."""
    kv, kt, kc, kq, kg, w0, tau, vim, vic, p0 = p
    ratio = min(max(x[0] / x[1], 0.528), 0.999)
    psi = np.sqrt(7.0 * (ratio ** (2.0 / 1.4) - ratio ** (2.4 / 1.4)))
    throttle = kt * max(u + f[0] + 0.002, 0.0) * x[1] * psi
    valves = 1.0 - 0.03 * ((n - 2500.0) / 1500.0) ** 2 - 0.04 * (100.0 / x[0] - 1.0)
    cylinders = kv * (1.0 + f[1]) * n * x[0] * valves
    compressor = (p0 * (1.0 + kc * x[2] ** 2) - x[1]) / kq
    gas = cylinders * (60.0 / cylinders) ** 0.05
    lag = tau * (1.0 + 0.15 * (60.0 - cylinders) / 60.0)
    slopes = np.array([
        (throttle - cylinders) / vim, (compressor - throttle - f[3] * (x[1] - p0)) / vic,
        (w0 + kg * gas * (1.0 - wg - f[2]) - x[2]) / lag,
    ])  # fmt: skip
    return slopes, compressor


@njit(cache=True)
def _solved(u, n, wg, p, f):
    """Return the states and the compressor's flow at each sample, by Heun's method."""
    found, x, h = np.zeros((len(u), 4)), np.array([80.0, 110.0, 80.0]), PERIOD_S / STEPS
    for k in range(-500, len(u)):
        j = max(k, 0)
        if k >= 0:
            found[k, :3], found[k, 3] = x, _slopes(x, u[k], n[k], wg[k], p, f[k])[1]
        for _ in range(STEPS):
            one, _flow = _slopes(x, u[j], n[j], wg[j], p, f[j])
            x = x + 0.5 * h * (one + _slopes(x + h * one, u[j], n[j], wg[j], p, f[j])[0])
    return found


def drive(seed: int, count: int, faults: Mapping[str, Array]) -> Array:
    """Return what the sensors and commands are."""
    rng, engine = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    p = np.array([value * (1.0 + engine.uniform(-OFF[k], OFF[k])) for k, value in NOMINAL.items()])
    n = course(rng, count, PERIOD_S, 1500.0, 3800.0, (4, 12))
    ratio = course(rng, count, PERIOD_S, 0.6, 0.9, (2, 8))
    u = NOMINAL["kv"] * n * ratio / (NOMINAL["kt"] * 0.685 * np.sqrt(1.0 - ((ratio - 0.528) / 0.472) ** 2))
    u, wg = np.round(u, 4), np.round(course(rng, count, PERIOD_S, 0.1, 0.5, (4, 12)), 3)
    f = all_of(faults, NAMES, count)
    x = _solved(u, n, wg, p, f)
    return np.stack([
        u, shown(rng, engine, n, (0.0, 0.0, 2.0, 0.25)), wg,
        shown(rng, engine, x[:, 3] + f[:, 4], (0.01, 0.2, 0.4, 0.05)),
        shown(rng, engine, x[:, 0] + f[:, 5], (0.005, 0.5, 0.3, 0.05)),
        shown(rng, engine, x[:, 1] + f[:, 6], (0.005, 0.5, 0.3, 0.05)),
        shown(rng, engine, x[:, 2] + f[:, 7], (0.002, 0.1, 0.4, 0.05)),
    ], 1)  # fmt: skip


AIR = Plant(
    "air",
    written(
        unknown=dict.fromkeys(("Wth", "Wcyl", "Wc", "pim", "pic", "wt"), ""),
        known=("u", "n", "wg", "y_waf", "y_pim", "y_pic", "y_wt"),
        faults={
            "f_thr": "throttle", "f_vol": "valves", "f_wg": "wastegate", "f_leak": "leak behind the compressor",
            "f_waf": "air flow meter", "f_pim": "intake pressure sensor", "f_pic": "boost pressure sensor",
            "f_wt": "turbo speed sensor",
        },
        parameters=NOMINAL,
        e1=(
            "Wth = kt * (u + f_thr) * pic * 0.685"
            " * sqrt(1 - ((min(max(pim / pic, 0.528), 0.99) - 0.528) / 0.472) ** 2)",
            "Wth",
        ),
        e2=("Wcyl = kv * (1 + f_vol) * n * pim", "Wcyl pim"),
        e3=("vim * der(pim) = Wth - Wcyl", "der(pim) Wth Wcyl"),
        e4=("vic * der(pic) = Wc - Wth - f_leak * (pic - p0)", "der(pic) Wc Wth"),
        e5=("pic = p0 * (1 + kc * wt ** 2) - kq * Wc", "pic Wc"),
        e6=("tau * der(wt) = w0 + kg * Wcyl * (1 - wg - f_wg) - wt", "der(wt) Wcyl"),
        e7=("y_waf = Wc + f_waf", "Wc"),
        e8=("y_pim = pim + f_pim", "pim"),
        e9=("y_pic = pic + f_pic", "pic"),
        e10=("y_wt = wt + f_wt", "wt"),
    ),
    PERIOD_S,
    ("u", "n", "wg", "y_waf", "y_pim", "y_pic", "y_wt"),
    """start = { pim = 80.0, pic = 110.0, wt = 80.0 }
settle_s = 3
confirm_s = 1
uncertain = { kv = "8 %", kt = "8 %", kc = "8 %", kq = "8 %", kg = "8 %", tau = "15 %" }
sensors.y_waf = { gain = "1.5 %", bias = 0.3 }
sensors.y_pim = { gain = "1 %", bias = 1.0 }
sensors.y_pic = { gain = "1 %", bias = 1.0 }
sensors.y_wt = { gain = "0.5 %", bias = 0.2 }
""",
    {
        "f_thr": (0.03, -0.02), "f_vol": (-0.25, -0.15), "f_wg": (0.25, -0.15), "f_leak": (0.3, 0.15),
        "f_waf": (8.0, 4.0, -5.0), "f_pim": (10.0, 5.0, -6.0), "f_pic": (10.0, 5.0, -6.0), "f_wt": (10.0, 5.0, -6.0),
    },
    {"f_waf": "y_waf", "f_pim": "y_pim", "f_pic": "y_pic", "f_wt": "y_wt"},
    drive,
)  # fmt: skip
