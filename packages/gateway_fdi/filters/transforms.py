"""Clarke and Park (paper 001, equations (5) to (11)).

The Clarke transform is amplitude invariant: a phase current I cos(phi) becomes I cos(phi), I sin(phi). The angle of
the Park transform is the electrical one, pole pairs times the mechanical angle; the paper writes theta for both.
"""

from __future__ import annotations

from math import cos, floor, sin, sqrt

from gateway_fdi.jit import kernel

_THIRD = 1.0 / sqrt(3.0)


@kernel
def clarke(i_u: float, i_v: float) -> tuple[float, float]:
    """Phase currents of a machine without neutral, (7), to alpha and beta, (5), (6)."""
    return i_u, (i_u + 2.0 * i_v) * _THIRD


@kernel
def inverse_clarke(alpha: float, beta: float) -> tuple[float, float]:
    """Alpha and beta to the phases U and V; W is minus their sum."""
    return alpha, 0.5 * (beta / _THIRD - alpha)


@kernel
def park(alpha: float, beta: float, theta_e: float) -> tuple[float, float]:
    """Stator to rotor co-ordinates, (8), (9); electrical angle [rad]."""
    c, s = cos(theta_e), sin(theta_e)
    return alpha * c + beta * s, beta * c - alpha * s


@kernel
def inverse_park(d: float, q: float, theta_e: float) -> tuple[float, float]:
    """Rotor to stator co-ordinates, (10), (11); electrical angle [rad]."""
    c, s = cos(theta_e), sin(theta_e)
    return d * c - q * s, d * s + q * c


@kernel
def wrap(angle: float, turn: float) -> float:
    """Return an angle between -turn/2 and turn/2 that differs by whole turns."""
    return float(angle - turn * floor(angle / turn + 0.5))
