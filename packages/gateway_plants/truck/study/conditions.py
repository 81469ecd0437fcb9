"""When T4 of ICDS is updated, by (39), (41), (45), and always (paper 004, Figs. 5, 6, 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_fdi import cusum
from gateway_fdi.detectors import StoppingRule
from gateway_plants.truck.ecu.params import TruckFault
from gateway_plants.truck.monitor.params import Params
from gateway_plants.truck.study.follow import inputs
from gateway_plants.truck.study.paper import (
    RESIDUALS,
    T4_ABSOLUTE,
    T4_FIXED,
    T4_SIGNED,
    Paper,
    Trace,
    calibrated,
    follow,
)
from gateway_plants.truck.study.table import TRUCK

Array = NDArray[np.float64]

CONDITIONS = ("(39)", "(41)", "(45)", "always")
#: Where residuals are noisy enough for the conditions to matter: noise, and J_1 [As] that stands out of it.
NOISE, CHARGE = 5.0, 6000.0
#: Faults of Figs. 5 and 9, and of Fig. 6, which begins with its two windows.
SENSOR = TruckFault(kind="machine_voltage_sensor", from_s=0.0)
EFFICIENCY = TruckFault(kind="machine_efficiency", from_s=440.0)
#: Place of T4 of ICDS among the residuals.
_T4 = RESIDUALS.index("T4_ICDS")
#: T is not limited here, as in the paper.
_UNLIMITED = 1e12


@dataclass(frozen=True)
class Compared:
    """T4 of ICDS with four conditions.

    Attributes:
        trace: of the drive.
        norm: T_norm, J by (46) without a floor, shape (n, 4).
    """

    trace: Trace
    norm: Array

    @property
    def on(self) -> tuple[float, ...]:
        """Share of the drive behind the first alarm in which T_norm is above 1; 0 without an alarm."""
        return tuple(_share(column) for column in self.norm.T)

    @property
    def down(self) -> tuple[float, ...]:
        """Sum of T's decreases over that of its increases."""
        steps = np.diff(self.norm, axis=0)
        rise = np.maximum(steps, 0.0).sum(axis=0)
        fall = np.maximum(-steps, 0.0).sum(axis=0)
        return tuple(float(f / r) if r else 0.0 for f, r in zip(fall, rise, strict=True))


def _share(norm: Array) -> float:
    alarmed = np.flatnonzero(norm > 1.0)
    return float((norm[alarmed[0] :] > 1.0).mean()) if len(alarmed) else 0.0


def _always(trace: Trace, nu: float) -> Array:
    """Return T of a quantity that is updated whenever the residual is there."""
    residual = trace.residual[:, _T4]
    taken = trace.settled & ~np.isnan(residual)
    sums = StoppingRule("cusum", np.inf, drift=nu).levels(np.abs(residual[taken]))
    return np.concatenate([[0.0], sums])[np.cumsum(taken)]


def compare(fault: TruckFault, seed: int) -> Compared:
    """Compare the conditions on FTP75, with noise that makes them matter.

    Args:
        fault: that the truck has.
        seed: of the noise; that of the healthy drive, which gives nu and J, is 10 000 more.
    """
    truck = TRUCK.model_copy(update={"noise_factor": NOISE})
    params = Paper(monitor=Params(follow=False, limit=_UNLIMITED), signed_charge=CHARGE)
    quiet = inputs(truck, None, seed + 10_000)
    params = calibrated(params, [quiet], floor=1.0)
    nu = params.nu[_T4]
    still = follow(quiet, params, keep=True).trace
    most = max(float(_always(still, nu).max()), nu) / cusum.MARGIN
    trace = follow(inputs(truck, fault, seed), params, keep=True).trace
    conditioned = trace.norm[:, [T4_FIXED, T4_SIGNED, T4_ABSOLUTE]]
    return Compared(trace, np.column_stack([conditioned, _always(trace, nu) / most]))
