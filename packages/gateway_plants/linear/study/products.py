"""The paper's own decision: products of flags over the bank (paper 003, (15) and (16), corrected).

    r_si = product over k != i of [|e_ki| >= Th_si]      (15)
    r_ai = product over all k of [|omega_ki| >= Th_ai]   (16), corrected

(16) is printed with k != i, like (15). But there i counts actuators and k observers, and leaving out observer i leaves
out the one that a fault of sensor i does not touch: flags of actuators for faults of sensors are the consequence.

Both are levels. e_ki of a constant sensor fault returns to 0, since a stationary observer has H e = 0 and H is regular
where p - 1 = m: r_s is a pulse of some samples.
"""

from __future__ import annotations

from gateway_fdi.jit import f8s, kernel


@kernel
def sensor(e: f8s, p: int, i: int, threshold: float) -> bool:
    """Return r_si of (15).

    Args:
        e: what each observer leaves of each sensor, shape (p + 1, p); row 0 is not looked at.
        p: sensors.
        i: the sensor.
        threshold: Th_si.
    """
    below = 0
    for k in range(1, p + 1):
        if k != i + 1 and abs(e[k, i]) < threshold:
            below += 1
    return below == 0


@kernel
def actuator(z: f8s, n: int, p: int, i: int, threshold: float, printed: bool) -> bool:
    """Return r_ai of (16).

    Args:
        z: states and faults of each observer, shape (p + 1, n + m); row 0 is not looked at.
        n: states.
        p: sensors.
        i: the actuator.
        threshold: Th_ai.
        printed: leave out observer i, as printed.
    """
    for k in range(1, p + 1):
        if printed and k == i + 1:
            continue
        if abs(z[k, n + i]) < threshold:
            return False
    return True
