"""Residual generator T1 of truck: made from its model, not by hand.

Consistency relation e34: U_em_sens = U_em + f_em_U_sens
Sequence ({U_em}, {e7})
"""

from typing import Any

from gateway_fdi.jit import Record, f8, kernel, means


class State(Record):
    unused_: f8 = means('nothing')


class Const(Record):
    unused_: f8 = means('nothing')


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
    r = -U_em + u.U_em_sens  # e34
    return float(r)
