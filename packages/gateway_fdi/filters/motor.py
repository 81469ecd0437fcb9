"""The permanent magnet synchronous motor (paper 001, equations (12) to (16)).

With the electrical angle theta_e = z_p theta and the amplitude invariant transforms of (5) to (11)::

    L_d dI_d/dt = U_d - R I_d + z_p omega L_q I_q                         (13)
    L_q dI_q/dt = U_q - R I_q - z_p omega (L_d I_d + psi)                 (12), (15)
    J domega/dt = 3/2 z_p (psi I_q + (L_d - L_q) I_d I_q) - b omega - M   (14), (16), corrected

Correction: (14) and (16) have c_M I_q with c_M = z_p psi. The power that is neither heat nor magnetic energy,
3/2 (U_d I_d + U_q I_q) - 3/2 R (I_d^2 + I_q^2) in steady state, must be torque times speed. That gives the factor
3/2, which (5), (6) bring with them (power invariant transforms would not), and the reluctance term.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway_fdi.jit import Record, f8, kernel, means

#: Temperature coefficient of copper's resistance, at 20 degC [1/K].
COPPER = 0.0039


class Const(Record):
    """Constants."""

    pole_pairs: f8 = means("z_p")
    flux: f8 = means("psi", "Wb")
    resistance: f8 = means("R", "Ohm")
    ld: f8 = means("L_d", "H")
    lq: f8 = means("L_q", "H")
    inertia: f8 = means("J", "kg m^2")
    friction: f8 = means("b", "N m s/rad")


@dataclass(frozen=True)
class Motor:
    """Values of a motor. Those of the defaults are assumed: those of an active front steering are not published.

    Attributes:
        pole_pairs: z_p.
        flux: of the magnets, psi [Wb]; z_p psi is the EMF constant c_M [V s/rad].
        resistance: of a phase at 20 degC [Ohm].
        ld: inductance along d [H].
        lq: along q [H].
        inertia: rotor with what it drives [kg m^2].
        friction: viscous [N m s/rad].
    """

    pole_pairs: int = 4
    flux: float = 7.5e-3
    resistance: float = 0.06
    ld: float = 1e-4
    lq: float = 1e-4
    inertia: float = 1.2e-4
    friction: float = 5e-4

    @property
    def emf(self) -> float:
        """EMF constant c_M [V s/rad]."""
        return self.pole_pairs * self.flux

    @property
    def torque(self) -> float:
        """Torque constant at I_d = 0, 3/2 c_M [N m/A]."""
        return 1.5 * self.emf

    @property
    def linear(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C of (19), (20) for (I_q, omega) with input U_q and output I_q; A[1, 0] has the 3/2 of (14)."""
        a = np.array(
            [
                [-self.resistance / self.lq, -self.emf / self.lq],
                [self.torque / self.inertia, -self.friction / self.inertia],
            ]
        )
        return a, np.array([[1.0 / self.lq], [0.0]]), np.array([[1.0, 0.0]])


def prepare(c: Const, motor: Motor) -> None:
    """Fill a record of Const."""
    for name in Const.dtype.names or ():
        setattr(c, name, getattr(motor, name))


@kernel
def torque(c: Const, i_d: float, i_q: float) -> float:
    """Return the air gap's torque [N m], (14) corrected."""
    return float(1.5 * c.pole_pairs * (c.flux * i_q + (c.ld - c.lq) * i_d * i_q))


@kernel
def warm_resistance(at_20: float, celsius: float) -> float:
    """Return the resistance of a copper winding at a temperature [degC]."""
    return at_20 * (1.0 + COPPER * (celsius - 20.0))
