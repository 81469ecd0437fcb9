"""The valve of the DAMADICS benchmark: positioner, pneumatic servo-motor, control valve, bypass; 19 faults.

Sources, by their numbers in the comments: [1] Bartys, de las Heras, "Actuator simulation of the DAMADICS benchmark
actuator system", Safeprocess 2003: equations; [2] Bartys, Syfert, "Using Damadics actuator benchmark library", v1.22,
2002: faults (its tables 4 to 22), drive, and the values of parameters in the library's blocks; [3] Bartys,
"Specification of actuators", v1.02, 2002; [4] IEC 60534-2-1: critical pressure ratio; [5] McCutcheon, Martin, Barnwell,
1993: density of water. Nothing of the library's code is here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gateway_arena.contract import SAMPLES, Array, Record, WithoutSlopes
from gateway_arena.indexes import FROM_S
from gateway_arena.plants.scipy_plant import onset_of
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import f8, f8s, kernel, record, zeros
from gateway_fdi.structure.file import load_model

#: Time between two samples, and the solver's step [s]; both are the benchmark's [2].
PERIOD_S, STEP_S = 1.0, 0.0025
#: Known variables: control value [1], pressures before and behind the valve [MPa], temperature [C], displacement [1],
#: flow [t/h]; ranges of the sensors, and their noise as a share of these: 0.0025 s of a density of 5e-9 [2].
KNOWNS = ("CV", "yP1", "yP2", "yT1", "yX", "yF")
RANGES = (1.0, 4.0, 4.0, 200.0, 1.0, 40.0)
NOISE = math.sqrt(2e-6)
#: Fault -> its scenarios: small, medium, big at once, or incipient (table 29 of [2]); strength of the first three.
MODES = {
    "f1": "SMB", "f2": "BI", "f3": "I", "f4": "I", "f5": "I", "f6": "I", "f7": "SMB", "f8": "SMB", "f9": "I",
    "f10": "SMB", "f11": "BI", "f12": "SMB", "f13": "SMBI", "f14": "SMB", "f15": "B", "f16": "SMB", "f17": "BI",
    "f18": "SMBI", "f19": "SMB",
}  # fmt: skip
STRENGTH = {"S": 0.25, "M": 0.5, "B": 0.75, "I": 1.0}
#: Fault -> its strength in the arena: that of "big", or 1 where the benchmark has it creep only; signs are its own [2].
FAULTS = {
    fault: (-1.0 if fault in ("f12", "f14", "f19") else 1.0) * STRENGTH["B" if "B" in modes else "I"]
    for fault, modes in MODES.items()
}
#: Time in which an incipient fault grows, of these and of all others; time behind that [s] (table 1 of the
#: "Benchmark definition", v1.0).
DEVELOPS_S, SLOWLY_S, OVER_S = {"f4": 3600, "f17": 3600, "f13": 900}, 84_000, 600


@dataclass(frozen=True)
class Scenario:
    """One of the 44 scenarios.

    Attributes:
        fault: its name.
        mode: S, M, B or I.
        develop_s: time in which it grows [s].
        lasts_s: to the end of the benchmark's zone [s].
    """

    fault: str
    mode: str
    develop_s: int
    lasts_s: int


def _scenario(fault: str, mode: str) -> Scenario:
    develop = DEVELOPS_S.get(fault, SLOWLY_S) if mode == "I" else 0
    return Scenario(fault, mode, develop, FROM_S + develop + OVER_S)


#: All of them, in the benchmark's order.
SCENARIOS = tuple(_scenario(fault, mode) for fault, modes in MODES.items() for mode in modes)


#: Parameters: those of the structural model in SI units, and the hysteresis' width in strokes. Their values are of [2];
#: supply pressure and gain are those of the library, not of [3].
VALUES = {
    "K_v": 120.0, "n": 5.0, "K_b": 19.75, "tau": 0.3, "K_p": 100.0, "c_in": 2.5e-6, "P_z": 6e5, "V_0": 5.5e-3,
    "A_e": 0.029, "k_s": 60892.0, "k_v": 1500.0, "D_b": 0.01,
}  # fmt: skip
Parameters = record(**dict.fromkeys(VALUES, f8))
#: Those that differ if the parameters are off.
UNCERTAIN = ("K_v", "n", "tau", "K_p", "c_in", "A_e", "k_s")


@kernel
def within(value: float, low: float, high: float) -> float:
    """Return a value between two bounds."""
    return min(max(value, low), high)


@kernel
def play(value: float, before: float, width: float) -> float:
    """Return the output of a hysteresis loop."""
    return max(value - 0.5 * width, min(value + 0.5 * width, before))


@kernel
def law(k_v: float, recovery: float, p1: float, p2: float, t: float) -> float:
    """Return the flow through a valve [t/h], [1] (7) to (9): Bernoulli's, or choked."""
    vapour = 10.0 ** (4.733 - 2149.0 / (t + 273.15))  # through steam's tables at 43 and 200 C [MPa]
    before = max(p1, vapour)
    choked = max(recovery * (before - (0.96 - 0.28 * math.sqrt(min(vapour / 22.06, 1.0))) * vapour), 0.0)  # [4]
    t = within(t, 0.0, 110.0)
    density = 1000.0 * (1.0 - (t + 288.9414) * (t - 3.9863) ** 2 / (508929.2 * (t + 68.12963)))  # [5]
    return 0.1 * k_v * math.sqrt(max(min(before - p2, choked), 0.0) * density)


@kernel
def transduced(cvi: float) -> float:
    """Return the current's share of air that a positioner's output gives: small in the middle [2]."""
    if cvi < -0.54:
        return -0.02 - 0.53 * min((-0.54 - cvi) / 0.4, 1.0)
    if cvi > 0.46:
        return 0.02 + 0.98 * min((cvi - 0.46) / 0.4, 1.0)
    return 0.04 * (cvi + 0.04)


@kernel
def rated(n: float, plug: float, fault: int, f: float) -> float:
    """Return the share of the flow coefficient that is open: equal percentage, linear near the seat [2]."""
    share = math.exp(-n * within(plug, 0.0, 0.975)) * min(1.0, (1.0 - min(plug, 1.0)) / 0.025)
    if fault == 2:
        share *= 1.0 - 0.2 * f
    elif fault == 3:
        share *= 1.0 + 0.1 * f
    return min(share, 1.0) + (0.1 * f if fault == 6 else 0.0)


@kernel
def travel(fault: int, f: float) -> float:
    """Return the stroke at which the stem is stopped, as a share of the whole."""
    if fault == 1:
        return 1.0 - f
    if fault == 2:
        return 1.0 - 0.2 * f
    return 1.0 + 0.1 * f if fault == 3 else 1.0


@kernel
def simulate(rows: f8s, c: Any, phases: f8s, fault: int, begin: float, develop: float, most: float) -> None:
    """Fill in the exact values of the known variables.

    Args:
        rows: of samples, shape (n, 6), in the units of :data:`KNOWNS`.
        c: parameters.
        phases: of the three sines [rad].
        fault: 1 to 19; 0: none.
        begin: when it begins [s].
        develop: time in which it grows [s].
        most: its strength then.
    """
    gas, atmosphere, high = 287.0 * 293.0, 101325.0, 0.0381
    steps = round(1.0 / 0.0025)
    h = 1.0 / steps
    cv = 0.5 + 0.25 * math.sin(phases[0])
    s1 = s2 = fed = cv
    x = z = high * cv
    mass = (atmosphere + (c.k_s * (x + 0.25 * high) + 2500.0) / c.A_e) * (c.V_0 + c.A_e * x) / gas
    for k in range(len(rows)):
        for j in range(steps):
            t = k + j * h
            f = most * within((t - begin) / max(develop, h), 0.0, 1.0)
            cv = 0.5 + 0.25 * math.sin(0.02 * math.pi * t + phases[0])
            p1 = 3.5 + 0.175 * math.sin(0.2 * math.pi * t + phases[1])
            p2 = (2.6 + 0.026 * math.sin(2.0 * t + phases[2])) * (1.0 - (f if fault == 17 else 0.0))
            heat = 43.0 + (200.0 + 100.0 * f if fault == 7 and f > 0.0 else 0.0)
            # valve: what it lets through, and the force of the contracted stream
            plug = x / high
            if fault == 2:
                plug = min(plug + 0.2 * f, 1.0)
            elif fault == 3:
                plug = max(plug - 0.1 * f, 0.0)
            opened = rated(c.n, plug, fault, f)
            recovery = 1.0 - 0.6 * plug
            drop = (p1 - p2) / recovery
            contracted = drop * 1e6 * math.pi * 0.05**2 / 4.0
            # positioner: two lags, lever, gain, transducer [1] figures 4 to 6
            s1 += h / c.tau * (cv - s1)
            s2 += h / c.tau * (s1 - s2)
            sensed = within(x * (1.0 + (1.25 * f if fault == 13 else 0.0)), -0.25 * high, 1.25 * high)
            fed = play(within(sensed / high, -0.26, 1.31), fed, f if fault == 15 else 0.0)
            lever = 0.5 + math.asin(within(fed - 0.5, -1.0, 1.0)) * 3.0 / math.pi
            current = transduced(within(c.K_p * (s2 - lever), -1.0, 1.0))
            if fault == 12:
                current = within(current * (1.0 - f), -1.0, 1.0)
            # chamber: isothermal air [1] (6)
            area = c.A_e * (1.0 - (f if fault == 10 else 0.0))
            pressure = mass * gas / (c.V_0 + area * x) - atmosphere
            supply = c.P_z * (1.0 - (f if fault == 16 else 0.0))
            over = ((supply if supply > 120e3 else 0.0) if current > 0.0 else 0.0) - pressure
            mass += h * c.c_in * abs(current) * math.copysign(math.sqrt(abs(over)), over)
            mass -= h * 2e-7 * (f if 9 <= fault <= 10 else 0.0) * math.sqrt(abs(pressure))
            # stem: forces [1] (1), without its mass, which 1.3 ms of viscous friction hide
            spring = c.k_s * (1.0 - (f if fault == 11 else 0.0)) * (x + 0.25 * high)
            force = 2.0 * 9.81 + pressure * area - contracted - spring
            top = high * travel(fault, f)
            if (x > 0.0 or force > 0.0) and (x < top or force < 0.0):
                z = within(z + h * within(force / c.k_v, -0.02, 0.02), -0.05 * high, 1.25 * high)
            width = max(0.0, c.D_b + (f if fault == 4 else 0.0))
            if fault == 8:
                width *= 1.0 + 0.5 * f * (1.0 - x / high)
            x = within(play(z, x, min(width, 1.0) * high), 0.0, top)
            if j == 0:
                flow = law(c.K_v * opened, recovery, p1, p2, heat) * (1.0 - (0.05 * f if fault == 5 else 0.0))
                if fault == 18:
                    flow += law(c.K_b * f, 1.0 - 0.55 * f, p1, p2, heat)
                row = rows[k]
                row[0], row[1], row[2], row[3] = cv, p1, p2, heat
                row[4], row[5] = sensed / high, flow * (1.0 + (f if fault == 19 else 0.0))


class ValvePlant(WithoutSlopes):
    """The valve as the arena takes it: the benchmark's drive at random phases, faults at once."""

    name, source, period_s = "valve", "DAMADICS valve; Bartys, de las Heras 2003", PERIOD_S
    commands: tuple[str, ...] = KNOWNS[:1]
    knowns: tuple[str, ...] = KNOWNS
    noise: tuple[float, ...] = (0.0, *(NOISE * scale for scale in RANGES[1:]))

    def __init__(self) -> None:
        self.model = load_model(shipped("models/valve.toml"))
        told = self.model.quantities
        self.sizes: Mapping[str, str] = {f: f"{told[f].text}, strength {v:g}" for f, v in FAULTS.items()}

    def record(self, seed: int, fault: str = "", off: float = 0.0, size: float = 1.0) -> Record:
        """Return a run (:class:`gateway_arena.contract.Plant`)."""
        onset = onset_of(seed) if fault else SAMPLES
        phases = np.random.default_rng([seed, 4]).uniform(0.0, 2.0 * np.pi, 3)
        strength = size * FAULTS[fault] if fault else 0.0
        return self.run(seed, SAMPLES, fault, onset, 0, strength, off, phases)

    def scenario(self, which: Scenario, seed: int, off: float) -> tuple[Record, Array]:
        """Return a run of a scenario, with the benchmark's own drive, and the strength of the fault."""
        sign = math.copysign(1.0, FAULTS[which.fault])
        strength = STRENGTH[which.mode]
        phases = np.zeros(3)
        record = self.run(seed, which.lasts_s, which.fault, FROM_S, which.develop_s, sign * strength, off, phases)
        grown = np.clip((record.t_s - FROM_S) / max(which.develop_s, STEP_S), 0.0, 1.0)
        return record, strength * grown

    def run(
        self, seed: int, samples: int, fault: str, onset: int, develop: int, strength: float, off: float, phases: Array
    ) -> Record:
        """Return a run of some samples; fault, onset, develop, strength and phases are those of :func:`simulate`."""
        rng = np.random.default_rng(seed)
        c = zeros(1, Parameters)[0]
        for name, value in VALUES.items():
            wrong = off * rng.choice([-1.0, 1.0]) if name in UNCERTAIN else 0.0
            c[name] = value * (1.0 + wrong)
        rows = np.zeros((samples, len(KNOWNS)))
        number = [*FAULTS].index(fault) + 1 if fault else 0
        simulate(rows, c, phases, number, float(onset), float(develop), strength)
        shown = np.clip(rows + rng.normal(size=rows.shape) * np.array(self.noise), 0.0, RANGES)
        return Record(np.arange(float(samples)) * PERIOD_S, shown, fault, onset)
