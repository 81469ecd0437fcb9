"""Residual generator T5 of truck: made from its model, not by hand.

Consistency relation e37: omega_gb_sens = omega_gb
Sequence ({U_em}, {e7}), ({I_em}, {e35}), ({omega_em}, {e8}), ({omega_mj}, {e16}), ({u_gb}, {e18}), ({omega_gb}, {e23})
"""

from typing import Annotated, Any

from gateway_fdi.structure.generator.runtime import interpolate
from gateway_fdi.jit import Record, f8, f8s, kernel, means


class State(Record):
    unused_: f8 = means('nothing')


class Const(Record):
    k_i: f8 = means('torque constant of the machine without losses', 'V s/rad')
    R_em: f8 = means('resistance of the machine', 'ohm')
    u_em: f8 = means('ratio of the machine to the joint')
    f_3_x: Annotated[f8s, 12] = means('ratio of the gearbox over gear: points')
    f_3_y: Annotated[f8s, 12] = means('ratio of the gearbox over gear: values')


@kernel
def reset(s: State, c: Const) -> None:
    """Let carried states begin at their start values."""
    pass


@kernel
def start(s: State, c: Const, u: Any) -> None:
    """Let the other states begin so that the residual does at zero."""
    pass


@kernel
def step(s: State, c: Const, u: Any, dt: float) -> float:
    """Take a sample, dt [s] behind the one before; returns the residual."""
    U_em = u.U_em_ctrl  # e7
    I_em = u.I_em_sens  # e35
    omega_em = (-I_em*c.R_em + U_em)/c.k_i  # e8
    omega_mj = omega_em/c.u_em  # e16
    u_gb = interpolate(c.f_3_x, c.f_3_y, u.gear)  # e18
    omega_gb = omega_mj/u_gb  # e23
    r = -omega_gb + u.omega_gb_sens  # e37
    return float(r)
