"""The example of paper 003, section 5: plant, thresholds, cases of Figs. 3 to 11, and gains.

B(1, 2) = 1 is kept as printed. In an aircraft's lateral motion, which the matrices look like, the roll angle's rate
does not depend on an actuator; but with 0 there the rank of Theorem 1 is 5 for i = 1, and the example fails its own
theorem. The paper gives no gains: six poles of an observer with two outputs leave six numbers free. These have its
poles.
"""

from __future__ import annotations

import numpy as np

from gateway_plants.linear.ecu.params import LinearFault
from gateway_plants.linear.mathematics.plant import LinearPlant, discretised

A = (
    (0.0, 1.0, 0.3096, 0.0),
    (0.0, -1.0541, 1.1396, -14.2955),
    (0.0, -1.0238, -0.2931, -0.7717),
    (0.1338, 0.2957, -0.9559, -0.0981),
)
B = ((0.0, 1.0), (-7.8013, -1.1160), (1.8013, -0.6584), (0.1454, 0.0169))
C = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
PERIOD = 0.1
DURATION = 12.0
#: Commands [rad].
COMMAND = 0.5
ACTUATOR_LIMIT, SENSOR_LIMIT = 0.01, 0.1
POLES = (-1.1, -1.2, -1.3, -1.4, -5.0, -10.0)
#: Standard deviation of the sensors that our bank is designed for.
NOISE = 0.01

#: K_i over H_i of the continuous observers, rows x1 to x4, omega1, omega2; columns: the outputs left, ascending.
GAINS = (
    (
        (-49.192353, -29.181305),
        (15.816249, 7.259663),
        (-0.111201, 2.738451),
        (2.542230, 0.433711),
        (-9.596587, -4.987057),
        (-35.802726, -21.550122),
    ),
    (
        (12.671465, -3.173364),
        (37.673029, -4.570597),
        (-8.378807, 5.883234),
        (-2.845178, -2.058348),
        (-1.910696, 0.809974),
        (13.742380, 0.529200),
    ),
    (
        (4.947398, 1.660520),
        (12.946257, 13.607302),
        (16.210219, 5.040618),
        (-9.796303, -3.919715),
        (5.161353, 1.377342),
        (1.569871, -0.347186),
    ),
)

#: Case -> (actuator, sensor) at fault, by their place from 1; 0: none.
FIGURES = {
    "Fig. 3": ("a1",),
    "Fig. 4": ("a2",),
    "Fig. 5": ("s1",),
    "Fig. 6": ("s2",),
    "Fig. 7": ("s3",),
    "Figs. 8, 9": ("a1", "s1"),
    "Figs. 10, 11": ("a2", "s2"),
}


def plant() -> LinearPlant:
    """Return the plant in discrete time."""
    return discretised(A, B, C, PERIOD)


def case(*parts: str) -> tuple[LinearFault, ...]:
    """Return the paper's faults: 0.05 of actuators from 2 s on, 0.5 of sensors from 4 s on.

    Args:
        parts: of a1, a2, s1, s2, s3.
    """
    faults = []
    for part in parts:
        place = int(part[1])
        if part[0] == "a":
            faults.append(LinearFault(kind="actuator_offset", place=place, from_s=2.0, size=0.05))
        else:
            faults.append(LinearFault(kind="output_offset", place=place, from_s=4.0, size=0.5))
    return tuple(faults)


def held(faults: tuple[LinearFault, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return faults of actuators (n, 2) and sensors (n, 3) at each sample, begun at the next sample."""
    count = round(DURATION / PERIOD)
    a, s = np.zeros((count, 2)), np.zeros((count, 3))
    for fault in faults:
        first = int(np.ceil(fault.from_s / PERIOD - 1e-9))
        into = a if fault.kind == "actuator_offset" else s
        into[first:, fault.place - 1] += fault.size
    return a, s
