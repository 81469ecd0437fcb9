"""The parallel hybrid truck of paper 004: equations e1 to e32 as a plant, 1 ms a step.

Corrected as in the structural model (``models/truck.toml``), whose parameters and tables these are. Beyond the
paper: the smaller root of the battery's current, a state of charge that stays in [0, 1], an engine that follows the
joint with a lag while its clutch slips.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin
from typing import Any

import numpy as np

from gateway_fdi.jit import f8, i8, kernel, record
from gateway_fdi.structure.generator.runtime import interpolate
from gateway_fdi.structure.model import Model

#: Length of a step [s].
STEP = 1e-3
#: Lag of an engine whose clutch slips [s]; slip below which the clutch holds [rad/s].
LAG, HOLDS = 0.12, 0.5
#: Length of a hill and the dale behind it [m].
HILL = 600.0
#: Engine speed [rad/s] and greatest torque [Nm] of a 12.7 l Diesel engine.
_RPM = (500.0, 600.0, 800.0, 1000.0, 1300.0, 1500.0, 1900.0, 2300.0)
_TORQUE = (900.0, 1100.0, 1600.0, 2300.0, 2300.0, 2060.0, 1628.0, 0.0)

_NUMBERS = (
    "q_LHV",
    "eta_e_i",
    "N_cyl",
    "B",
    "S",
    "p_me0_g",
    "k_1",
    "k_2",
    "k_3",
    "k_4",
    "Pi_bl",
    "omega_e_idle",
    "Q_b",
    "R_b",
    "k_i",
    "R_em",
    "eta_em_0",
    "c_em_f",
    "u_em",
    "J_em",
    "J_c",
    "J_e",
    "eta_pos",
    "eta_neg",
    "u_f",
    "m_v0",
    "rho",
    "C_d",
    "A_f",
    "C_r",
    "r_w",
    "g",
    "c_w",
)

CONST = record(
    **dict.fromkeys(_NUMBERS, f8),
    charge_x=(f8, 11),
    charge_y=(f8, 11),
    ratio=(f8, 12),
    inertia=(f8, 12),
    speed_x=(f8, 8),
    torque_y=(f8, 8),
    slope=f8,
    hills=f8,
    wind=f8,
    engine=f8,
    brake=f8,
)

STATE = record(omega_w=f8, omega_e=f8, soc=f8, fuel=f8, way=f8, locked=i8)

#: What the actuators do: fuel energy a cycle [J], voltage [V], clutch 0 to 1, gear 0 to 12, brake torque [Nm].
COMMAND = record(ice=f8, volts=f8, clutch=f8, gear=i8, brake=f8)

#: Faults (13): relative errors, and an offset [V] that is not the plant's business.
FAULT = record(b_sc=f8, pe=f8, em_eta=f8, em_R=f8, em_U_sens=f8)

#: What is measured: currents [A], voltage [V].
ELECTRIC = record(i_b=f8, u_em=f8, i_em=f8)


@dataclass(frozen=True)
class Disturbance:
    """How a truck differs from its model.

    Attributes:
        mass: of the truck, relative.
        slope: of the road that nobody measures [rad].
        hills: amplitude of a slope that comes and goes over :data:`HILL` [rad].
        wind: against it [m/s].
        engine: torque of the engine, relative.
        brake: torque of the brakes, relative.
        drag: air drag, relative.
    """

    mass: float = 1.0
    slope: float = 0.0
    hills: float = 0.0
    wind: float = 0.0
    engine: float = 1.0
    brake: float = 1.0
    drag: float = 1.0


def prepare(c: np.void, model: Model, disturbance: Disturbance) -> None:
    """Fill a record of CONST from the truck's structural model."""
    for name in _NUMBERS:
        value = model.quantities[name].value
        if value is None:
            raise ValueError(f'parameter "{name}" of {model.name} has no value')
        c[name] = value
    c["m_v0"] *= disturbance.mass
    c["C_d"] *= disturbance.drag
    c["charge_x"], c["charge_y"] = model.tables["f_1"].x, model.tables["f_1"].y
    c["inertia"], c["ratio"] = model.tables["f_2"].y, model.tables["f_3"].y
    c["speed_x"], c["torque_y"] = np.array(_RPM) * pi / 30.0, _TORQUE
    c["slope"], c["hills"], c["wind"] = disturbance.slope, disturbance.hills, disturbance.wind
    c["engine"], c["brake"] = disturbance.engine, disturbance.brake


@kernel
def friction(c: Any, omega_e: float) -> float:
    """Return the friction mean effective pressure [Pa], e3."""
    return float(c.k_1 * (c.k_2 + c.k_3 * c.S**2 * omega_e**2) * c.Pi_bl * (c.k_4 / c.B) ** 0.5)


@kernel
def engine_torque(c: Any, ice: float, omega_e: float) -> float:
    """Return the engine's torque [Nm], e2."""
    mean = ice * 4.0 * c.eta_e_i / (c.N_cyl * pi * c.S * c.B**2) - friction(c, omega_e) - c.p_me0_g
    return float(mean * c.N_cyl * c.S * c.B**2 / 16.0)


@kernel
def fuel_for(c: Any, torque: float, omega_e: float) -> float:
    """Return the fuel energy of a cycle [J] that gives a torque: e2 the other way round."""
    mean = torque * 16.0 / (c.N_cyl * c.S * c.B**2) + friction(c, omega_e) + c.p_me0_g
    return float(mean * c.N_cyl * pi * c.S * c.B**2 / (4.0 * c.eta_e_i))


@kernel
def electrics(c: Any, s: Any, u: Any, f: Any, omega_em: float, out: Any) -> None:
    """Compute the machine's and the battery's currents: e5 to e8, e11, with the faults (13a), (13b), (13d)."""
    out.u_em = (1.0 + f.pe) * u.volts
    out.i_em = (out.u_em - c.k_i * omega_em) / (c.R_em * (1.0 + f.em_R))
    open_volts = interpolate(c.charge_x, c.charge_y, s.soc)
    power = out.i_em * out.u_em / (1.0 + f.b_sc)
    under = open_volts**2 - 4.0 * c.R_b * power
    out.i_b = (open_volts - max(under, 0.0) ** 0.5) / (2.0 * c.R_b)


@kernel
def resistance(c: Any, omega_w: float, mass: float) -> float:
    """Return air drag and rolling resistance at the wheels [Nm]: e25 with wind, e26."""
    air = omega_w * c.r_w + c.wind
    roll = mass * c.g * c.C_r * c.r_w
    drag = 0.5 * c.rho * c.C_d * c.A_f * air * abs(air) * c.r_w
    return float(drag + max(-roll, min(roll, c.c_w * omega_w)))


@kernel
def step(c: Any, s: Any, u: Any, f: Any, out: Any) -> None:
    """Step the plant by 1 ms; ``out`` is scratch."""
    omega_gb = s.omega_w * c.u_f
    ratio = c.ratio[u.gear - 1] if u.gear > 0 else 0.0
    omega_mj = ratio * omega_gb
    omega_em = c.u_em * omega_mj
    mass = c.m_v0 - s.fuel
    electrics(c, s, u, f, omega_em, out)
    k_a = c.k_i * ((c.eta_em_0 * (1.0 + f.em_eta)) if out.i_em > 0.0 else 1.0 / (c.eta_em_0 * (1.0 + f.em_eta)))
    torque = (out.i_em * k_a - c.c_em_f * omega_em) * c.u_em
    inertia = c.J_em * c.u_em**2
    # (10): an engine does not follow the joint below idle; while the clutch slips it follows with a lag.
    target = max(c.omega_e_idle, omega_mj)
    if u.clutch > 0.995 and abs(s.omega_e - omega_mj) < HOLDS:
        s.locked = 1
    elif u.clutch < 0.995 or omega_mj < c.omega_e_idle - HOLDS:
        s.locked = 0
    if s.locked == 1:
        s.omega_e = omega_mj
        inertia += c.J_c + c.J_e
    else:
        s.omega_e += STEP / LAG * (target - s.omega_e)
    torque += u.clutch * c.engine * engine_torque(c, u.ice, s.omega_e)
    slope = c.slope + c.hills * sin(2.0 * pi * s.way / HILL)
    net = -resistance(c, s.omega_w, mass) - mass * c.g * c.r_w * sin(slope)
    total = mass * c.r_w**2
    if u.gear > 0:
        loss = 8.0 + 0.6 * (12 - u.gear) + 0.08 * omega_mj
        through = torque - loss
        net += through * (c.eta_pos if through > 0.0 else c.eta_neg) * ratio * c.u_f
        total += ratio**2 * (c.inertia[u.gear - 1] + inertia) * c.u_f**2
    braking = c.brake * u.brake
    after = s.omega_w + STEP * (net - braking) / total
    # Brakes and losses stop a truck, they do not push it back.
    s.omega_w = max(after, 0.0)
    s.way += STEP * s.omega_w * c.r_w
    s.fuel += STEP * u.ice * s.omega_e / (4.0 * pi * c.q_LHV)
    s.soc = min(max(s.soc - STEP * out.i_b / c.Q_b, 0.0), 1.0)
