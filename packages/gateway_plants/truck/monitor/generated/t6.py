"""Residual generator T6 of truck: made from its model, not by hand.

Consistency relation e11: I_b = I_em * U_em / U_b
Sequence ({I_b}, {e33}), ({SoC}, {e4}), ({U_oc}, {e5}), ({U_b}, {e6}), ({U_em}, {e34}), ({I_em}, {e35})
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
    f_1_x: Annotated[f8s, 11] = means('open circuit voltage [V] over state of charge: points')
    f_1_y: Annotated[f8s, 11] = means('open circuit voltage [V] over state of charge: values')
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
    U_em = u.U_em_sens  # e34
    I_em = u.I_em_sens  # e35
    s.d_SoC = d_SoC if isfinite(d_SoC) else 0.0
    r = I_b - I_em*U_em/U_b  # e11
    return float(r)
