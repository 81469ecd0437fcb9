"""A turbocharged petrol engine: filter, compressor, intercooler, throttle, cylinders, turbine, wastegate; 11 faults.

Plant and faults are those of Ng, Frisk, Krysander, Eriksson, "A realistic simulation testbed of a turbocharged spark
ignited engine system", IEEE Control Systems Magazine 40(2), 2020. The equations are derived again from [1] Eriksson,
"Modeling and control of turbocharged SI and DI engines", Oil & Gas Science and Technology 62(4), 2007, whose mean value
model that is; [2] Heywood, "Internal combustion engine fundamentals", 1988, has orifices, torque and friction. The
parameters are our own, for an engine of the same size; nothing of the testbed's code or data is here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gateway_arena.contract import SAMPLES, Array, Record, WithoutSlopes
from gateway_arena.plants.scipy_plant import onset_of
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import f8, f8s, kernel, record, zeros
from gateway_fdi.structure.file import load_model

#: Time between two samples [s].
PERIOD_S = 0.1
#: Fault -> its size: shares, areas [mm2], [K].
FAULTS = {
    "fp_af": 8.0, "fC_vol": 0.08, "fW_af": 100.0, "fW_c": 10.0, "fW_ic": 10.0, "fW_th": 5.0, "fx_th": 4.0,
    "fyp_ic": 0.2, "fyp_im": 0.19, "fyT_ic": -20.0, "fyW_af": 0.2,
}  # fmt: skip
#: Commands, then sensors: areas [mm2], shares, [rad/s]; temperatures [K], pressures [kPa], flow [g/s], torque [Nm].
KNOWNS = (
    "A_th", "u_wg", "w_e", "yT_c", "yp_c", "yT_ic", "yp_ic", "yT_im", "yp_im", "yW_af", "yTq", "yp_em",
)  # fmt: skip
#: Noise of the sensors: of the virtual ECU, and of the testbed, 1/120 of the signal's root mean square.
NOISE = (0.0, 0.0, 0.0, 0.5, 0.3, 0.5, 0.3, 0.5, 0.2, 0.2, 1.0, 0.5)
TESTBED = (0.0, 0.0, 0.0, 2.55, 0.9, 2.5, 0.87, 2.5, 0.61, 0.25, 0.75, 0.95)
#: Parameters: those of the structural model in SI units; efficiency of the turbine, its inertia [kg m2].
VALUES = {
    "H_af": 3e8, "H_ic": 1e9, "H_es": 4e8, "D_c": 0.058, "Phi": 0.125, "Psi": 2.2, "e_c": 0.78, "e_ic": 0.8,
    "c_vol": 0.92, "V_d": 1.8e-3, "e_ig": 0.36, "k_t": 0.016, "e_t": 0.68, "J": 3.5e-5,
}  # fmt: skip
Parameters = record(**dict.fromkeys(VALUES, f8))


@kernel
def orifice(area: float, p1: float, p2: float, t: float) -> float:
    """Return the flow of air through an orifice [kg/s], [2]: choked below a ratio of 0.53, linear above 0.95."""
    ratio, sign = p2 / p1, 1.0
    if ratio > 1.0:
        ratio, sign, p1 = 1.0 / ratio, -1.0, p2
    edge = min(ratio, 0.95)
    edge = max(edge, 0.5283)
    psi = math.sqrt(7.0 * (edge ** (2.0 / 1.4) - edge ** (2.4 / 1.4)))
    if ratio > 0.95:
        psi *= (1.0 - ratio) / 0.05
    return sign * area * p1 / math.sqrt(287.0 * t) * psi


@kernel
def resisted(h: float, p1: float, p2: float, t: float) -> float:
    """Return the flow through a resistance [kg/s], [1]: with the root of the difference, linear below 1 kPa."""
    drop = p1 - p2
    root = math.sqrt(drop) if drop > 1000.0 else drop / math.sqrt(1000.0)
    return math.sqrt(p1 / (h * t)) * root


@kernel
def slopes(x: f8s, d: f8s, y: f8s, c: Any, u: f8s, f: f8s) -> None:
    """Compute slopes and what sensors would show without noise.

    Args:
        x: states, shape (13,): mass and temperature of six volumes from the filter to the exhaust; turbine [rad/s].
        d: their slopes, changed.
        y: of the sensors, shape (9,), SI units, changed.
        c: parameters.
        u: area of the throttle [m2], wastegate [1], engine's speed [rad/s], shape (3,).
        f: of the faults, shape (11,); areas in m2.
    """
    p_a, t_a = 101300.0, 298.0
    r_e = 290.0
    p_af = x[0] * 287.0 * x[6] / 0.01
    p_c = x[1] * 287.0 * x[7] / 0.005
    p_ic = x[2] * 287.0 * x[8] / 0.005
    p_im = x[3] * 287.0 * x[9] / 0.002
    p_em = x[4] * r_e * x[10] / 0.0025
    p_t = x[5] * r_e * x[11] / 0.02
    w_t = max(x[12], 1000.0)
    # flows: filter, compressor [1], intercooler, throttle, cylinders [1]
    w_af = resisted(c.H_af * (1.0 + f[0]), p_a, p_af, t_a)
    rps = w_t / (2.0 * math.pi)
    ratio = max(p_c / p_af, 1.0)
    rise = ratio ** (0.4 / 1.4) - 1.0
    head = 1005.0 * x[6] * rise / (c.D_c * rps) ** 2 / c.Psi
    phi = c.Phi * math.sqrt(max(1.0 - head * head, 1e-4))
    w_c = phi * p_af / (287.0 * x[6]) * rps * c.D_c**3
    e_c = max(c.e_c * (1.0 - ((phi / c.Phi - 0.6) / 0.8) ** 2), 0.3)
    t_c = x[6] * (1.0 + rise / e_c)
    w_ic = resisted(c.H_ic, p_c, p_ic, x[7])
    t_ic = x[7] - c.e_ic * (x[7] - t_a) if w_ic > 0.0 else x[8]
    w_th = orifice(u[0] + f[6], p_ic, p_im, x[8])
    w_cyl = (
        c.c_vol * (1.0 - f[1]) * (9.5 - (p_em / p_im) ** (1.0 / 1.3)) / 8.5
        * c.V_d * u[2] / (4.0 * math.pi) * p_im / (287.0 * x[9])
    )  # fmt: skip
    # leaks
    l_af = orifice(f[2], p_a, p_af, t_a)
    l_c = orifice(f[3], p_c, p_a, x[7])
    l_ic = orifice(f[4], p_ic, p_a, x[8])
    l_th = orifice(f[5], p_a, p_im, t_a)
    # exhaust: temperature rises with flow [1], turbine, wastegate
    fuel = w_cyl / 15.1
    w_e = w_cyl + fuel
    t_e = 1000.0 + 3000.0 * w_e
    back = min(p_t / p_em, 1.0)
    w_tu = c.k_t * p_em / 1000.0 / math.sqrt(x[10]) * math.sqrt(max(1.0 - back**1.4, 1e-6))
    w_wg = orifice(3e-4 * u[1], p_em, p_t, x[10])
    cooled = c.e_t * (1.0 - back ** (0.3 / 1.3))
    t_t = x[10] * (1.0 - cooled * w_tu / max(w_tu + w_wg, 1e-6))
    w_es = resisted(c.H_es, p_t, p_a, x[11])
    power = w_tu * 1256.0 * x[10] * cooled - w_c * 1005.0 * (t_c - x[6])
    d[12] = (power / w_t - 1e-6 * w_t) / c.J
    flows_in = (w_af + l_af, w_c, w_ic, w_th + l_th, w_e, w_tu + w_wg)
    flows_out = (w_c, w_ic + l_c, w_th + l_ic, w_cyl, w_tu + w_wg, w_es)
    warm = (t_a, t_c, t_ic, x[8], t_e, t_t)
    for k in range(6):
        kappa = 1.4 if k < 4 else 1.3
        d[k] = flows_in[k] - flows_out[k]
        # energy of an open volume [2]: what comes in brings kappa times its temperature
        d[6 + k] = (flows_in[k] * (kappa * warm[k] - x[6 + k]) - flows_out[k] * (kappa - 1.0) * x[6 + k]) / x[k]
    # torque [2]: indicated, less pumping and friction
    gross = c.e_ig * 4.4e7 * fuel / max(u[2], 10.0)
    friction = (9e4 + 1.2e2 * u[2]) * c.V_d / (4.0 * math.pi)
    y[0], y[1], y[2], y[3], y[4] = x[7], p_c, x[8] + f[9], p_ic * (1.0 + f[7]), x[9]
    y[5], y[6] = p_im * (1.0 + f[8]), w_af * (1.0 + f[10])
    y[7], y[8] = gross - (p_em - p_im) * c.V_d / (4.0 * math.pi) - friction, p_em


@kernel
def simulate(rows: f8s, c: Any, drive: f8s, sizes: f8s, work: f8s) -> None:
    """Fill in the exact values of the known variables.

    The throttle follows the pressure that the torque wants, by a PI-controller on its sensor; so does the wastegate.
    Sensors of temperature lag by 0.5 s.

    Args:
        rows: of samples, shape (n, 12), in the units of :data:`KNOWNS`.
        c: parameters.
        drive: engine's speed [rad/s] and pressure of the intake that is wanted [Pa], shape (n + 1, 2).
        sizes: of the faults, shape (n, 11).
        work: zeros, shape (10, 13); the states at the end are its first row.
    """
    h = 0.1 / 50
    x, y, u, f = work[0], work[1], work[2], work[3]
    a, b, e, g, s, felt = work[4], work[5], work[6], work[7], work[8], work[9]
    volume = (0.01, 0.005, 0.005, 0.002, 0.0025, 0.02)
    for k in range(6):
        x[6 + k] = 298.0 if k < 4 else 1000.0
        x[k] = 101300.0 * volume[k] / ((287.0 if k < 4 else 290.0) * x[6 + k])
    x[12] = 5000.0
    felt[0] = felt[2] = felt[4] = 298.0
    held, opened = 0.1, 0.5
    u[2] = drive[0, 0]
    slopes(x, a, y, c, u, f)
    for k in range(len(rows)):
        for j in range(11):
            f[j] = sizes[k, j]
        for m in range(50):
            part = m / 50
            u[2] = drive[k, 0] + part * (drive[k + 1, 0] - drive[k, 0])
            wanted = drive[k, 1] + part * (drive[k + 1, 1] - drive[k, 1])
            if m % 5 == 0:
                miss = (wanted - y[5]) / 1e5
                held = min(max(held + 0.01 * miss * 0.6, 0.01), 1.0)
                u[0] = 1e-3 * min(max(held + 0.3 * miss, 0.005), 1.0)
                over = (y[3] - max(wanted + 8e3, 104e3)) / 1e5
                opened = min(max(opened + 0.01 * over * 2.0, 0.0), 1.0)
                u[1] = min(max(opened + over, 0.0), 1.0)
                if m == 0:
                    row = rows[k]
                    row[0], row[1], row[2] = 1e6 * u[0], u[1], u[2]
                    slopes(x, a, y, c, u, f)
                    row[3], row[4], row[5], row[6], row[7] = felt[0], y[1] / 1e3, felt[2], y[3] / 1e3, felt[4]
                    row[8], row[9], row[10], row[11] = y[5] / 1e3, 1e3 * y[6], y[7], y[8] / 1e3
            slopes(x, a, y, c, u, f)
            for i in range(0, 5, 2):
                felt[i] += h / 0.5 * (y[i] - felt[i])
            for share, before, here in ((0.5, a, b), (0.5, b, e), (1.0, e, g)):
                for i in range(13):
                    s[i] = x[i] + share * h * before[i]
                slopes(s, here, y, c, u, f)
            for i in range(13):
                x[i] += h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * e[i] + g[i])


def drive_of(rng: np.random.Generator, samples: int = SAMPLES) -> Array:
    """Return a drive, shape (n + 1, 2): speeds and pressures that change within some seconds, then stay for some."""
    at, points = 0.0, []
    while at < samples * PERIOD_S + 1.0:
        speed, stays = rng.uniform(150.0, 380.0), rng.uniform(2.0, 6.0)
        level = (speed, rng.uniform(45e3, 80e3 + 30e3 * (speed - 150.0) / 230.0))
        points += [(at, *level), (at + stays, *level)]
        at += stays + rng.uniform(3.0, 8.0)
    t, speeds, pressures = np.array(points).T
    times = np.arange(samples + 1) * PERIOD_S
    return np.stack([np.interp(times, t, speeds), np.interp(times, t, pressures)], 1)


def in_si(fault: str) -> float:
    """Return the size of a fault in the solver's units."""
    return FAULTS[fault] * (1e-6 if fault.startswith(("fW_", "fx_")) else 1.0)


def driven(rng: np.random.Generator, drive: Array, sizes: Array, off: float, noise: tuple[float, ...] = NOISE) -> Array:
    """Return the values of the known variables as sensors show them, shape (n, 12).

    Args:
        rng: of noise, and of what is off.
        drive: shape (n + 1, 2).
        sizes: of the faults in the solver's units, shape (n, 11).
        off: share by which parameters differ from the model's.
        noise: of each known variable.
    """
    c = zeros(1, Parameters)[0]
    for name, value in VALUES.items():
        c[name] = value * (1.0 + off * rng.choice([-1.0, 1.0]))
    rows = np.zeros((len(sizes), len(KNOWNS)))
    simulate(rows, c, drive, sizes, np.zeros((10, 13)))
    return np.asarray(rows + rng.normal(size=rows.shape) * np.array(noise))


class TurboPlant(WithoutSlopes):
    """The engine as the arena takes it, on random drives."""

    name, source, period_s = "turbo", "turbocharged engine; Ng, Frisk, Krysander, Eriksson 2020", PERIOD_S
    commands: tuple[str, ...] = KNOWNS[:3]
    knowns: tuple[str, ...] = KNOWNS
    noise: tuple[float, ...] = TESTBED

    def __init__(self) -> None:
        self.model = load_model(shipped("models/turbo.toml"))
        told = self.model.quantities
        self.sizes: Mapping[str, str] = {f: f"{told[f].text}, {v:g} {told[f].unit}".strip() for f, v in FAULTS.items()}

    def record(self, seed: int, fault: str = "", off: float = 0.0, size: float = 1.0) -> Record:
        """Return a run (:class:`gateway_arena.contract.Plant`)."""
        onset = onset_of(seed) if fault else SAMPLES
        sizes = np.zeros((SAMPLES, len(FAULTS)))
        if fault:
            sizes[onset:, [*FAULTS].index(fault)] = size * in_si(fault)
        shown = driven(np.random.default_rng(seed), drive_of(np.random.default_rng([seed, 5])), sizes, off, TESTBED)
        return Record(np.arange(float(SAMPLES)) * PERIOD_S, shown, fault, onset)
