"""Residual generator T2 of truck: made from its model, not by hand.

Consistency relation e11: I_b = I_em * U_em / U_b
Sequence ({I_b}, {e33}), ({SoC}, {e4}), ({U_oc}, {e5}), ({U_b}, {e6}), ({I_em}, {e35}), ({u_gb}, {e18}), ({omega_gb}, {e37}), ({omega_mj}, {e23}), ({omega_em}, {e16}), ({U_em}, {e8})
"""

from math import isfinite
from typing import Annotated, Any

from gateway_fdi.structure.generator.runtime import interpolate
from gateway_fdi.jit import Record, f8, f8s, kernel, means


class State(Record):
    SoC: f8 = means('state of charge')
    d_SoC: f8 = means('derivative of SoC', '1/s')


class Const(Record):
    Q_b: f8 = means('charge of the battery', 'As')
    R_b: f8 = means('inner resistance of the battery', 'ohm')
    k_i: f8 = means('torque constant of the machine without losses', 'V s/rad')
    R_em: f8 = means('resistance of the machine', 'ohm')
    u_em: f8 = means('ratio of the machine to the joint')
    f_1_x: Annotated[f8s, 11] = means('open circuit voltage [V] over state of charge: points')
    f_1_y: Annotated[f8s, 11] = means('open circuit voltage [V] over state of charge: values')
    f_3_x: Annotated[f8s, 12] = means('ratio of the gearbox over gear: points')
    f_3_y: Annotated[f8s, 12] = means('ratio of the gearbox over gear: values')
    start_SoC: f8 = means('SoC at the start')


@kernel
def reset(s: State, c: Const) -> None:
    """Let carried states begin at their start values."""
    s.SoC = c.start_SoC


@kernel
def start(s: State, c: Const, u: Any) -> None:
    """Let the other states begin so that the residual does at zero."""
    s.d_SoC = 0.0


@kernel
def step(s: State, c: Const, u: Any, dt: float) -> float:
    """Take a sample, dt [s] behind the one before; returns the residual."""
    s.SoC += dt * s.d_SoC
    I_b = u.I_b_sens  # e33
    d_SoC = -I_b/c.Q_b  # e4
    U_oc = interpolate(c.f_1_x, c.f_1_y, s.SoC)  # e5
    U_b = -I_b*c.R_b + U_oc  # e6
    I_em = u.I_em_sens  # e35
    u_gb = interpolate(c.f_3_x, c.f_3_y, u.gear)  # e18
    omega_gb = u.omega_gb_sens  # e37
    omega_mj = omega_gb*u_gb  # e23
    omega_em = omega_mj*c.u_em  # e16
    U_em = I_em*c.R_em + c.k_i*omega_em  # e8
    s.d_SoC = d_SoC if isfinite(d_SoC) else 0.0
    r = I_b - I_em*U_em/U_b  # e11
    return float(r)
