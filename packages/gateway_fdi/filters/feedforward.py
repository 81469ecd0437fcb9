"""Feed-forward filter: the angle of the EMF (paper 001, equations (17), (18), (46)).

(17), (18) with the electrical angle, differentiated::

    E_alpha = U_alpha - R I_alpha - L dI_alpha/dt = -psi omega_e sin(theta_e)
    E_beta  = U_beta  - R I_beta  - L dI_beta/dt  =  psi omega_e cos(theta_e)
    theta_e = -arctan(E_alpha / E_beta)                                                  (46), corrected

Correction: (46) has a plus before L dI/dt. In steady rotation L dI/dt is L omega_e I_q, at a right angle to R I; the
wrong sign turns the EMF by arctan(2 L I_q / psi): 14.93 deg electrical at 10 A with the default motor. Valid only for
L_d = L_q. The angle is known modulo pi (electrical) alone, because an arctangent cannot tell the sign of omega.
"""

from __future__ import annotations

from math import atan2, hypot, pi

from gateway_fdi.filters.motor import Motor
from gateway_fdi.filters.transforms import wrap
from gateway_fdi.jit import Record, f8, i8, kernel, means


class Const(Record):
    """Constants."""

    resistance: f8 = means("R", "Ohm")
    inductance: f8 = means("L", "H")
    period: f8 = means("length of a step", "s")
    sign: f8 = means("sign of L dI/dt: 1, or -1 as printed")
    held: f8 = means("EMF below which the angle is held", "V")
    pole_pairs: f8 = means("z_p")


class State(Record):
    """Currents, and angles at the middle of the step."""

    alpha: f8 = means("I_alpha at its end", "A")
    beta: f8 = means("I_beta at its end", "A")
    theta_e: f8 = means("electrical angle, counted over the half turns", "rad")
    theta: f8 = means("mechanical angle, likewise", "rad")
    started: i8 = means("1: there is a step before")


def prepare(c: Const, motor: Motor, period: float, *, held: float = 0.3, printed: bool = False) -> None:
    """Fill a record of Const.

    Args:
        period: of a step [s].
        held: below this EMF the angle is held [V].
        printed: the sign of (46) as printed.
    """
    c.resistance, c.inductance = motor.resistance, 0.5 * (motor.ld + motor.lq)
    c.period, c.held, c.pole_pairs = period, held, motor.pole_pairs
    c.sign = -1.0 if printed else 1.0


@kernel
def emf(
    s: State,
    c: Const,
    u_alpha: float,
    u_beta: float,
    i_alpha: float,
    i_beta: float,
    resistance: float,
) -> tuple[float, float]:
    """Return the EMF's mean over the step that ends now [V]; keeps the currents.

    Args:
        u_alpha: mean voltage over the step [V].
        u_beta: of beta.
        i_alpha: current at its end [A].
        i_beta: of beta.
        resistance: as warm as it is [Ohm].
    """
    rate = c.sign * c.inductance / c.period
    e_alpha = u_alpha - resistance * 0.5 * (i_alpha + s.alpha) - rate * (i_alpha - s.alpha)
    e_beta = u_beta - resistance * 0.5 * (i_beta + s.beta) - rate * (i_beta - s.beta)
    s.alpha, s.beta = i_alpha, i_beta
    return e_alpha, e_beta


@kernel
def step(s: State, c: Const, u_alpha: float, u_beta: float, i_alpha: float, i_beta: float) -> None:
    """Take one step; arguments as of :func:`emf`."""
    e_alpha, e_beta = emf(s, c, u_alpha, u_beta, i_alpha, i_beta, c.resistance)
    if s.started == 0:
        s.started = 1
        return
    if hypot(e_alpha, e_beta) < c.held:
        return
    moved = wrap(atan2(-e_alpha, e_beta) - s.theta_e, pi)
    s.theta_e += moved
    s.theta = s.theta_e / c.pole_pairs
