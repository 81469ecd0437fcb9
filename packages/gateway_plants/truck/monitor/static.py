"""Tests that need no motion of the vehicle: T1, T2, T5 and T6."""

from __future__ import annotations

from gateway_fdi import cusum
from gateway_fdi.jit import kernel
from gateway_fdi.slow import filter as slow
from gateway_plants.truck.monitor import alignment, blanking, following, gate
from gateway_plants.truck.monitor.generated import t1, t2, t5, t6
from gateway_plants.truck.monitor.messages import Inputs
from gateway_plants.truck.monitor.records import R1, R2, R5, R6, T1, T2, T5, T6, Const, State


@kernel
def take_beyond(s: State, c: Const, place: int, residual: float, doubt: float, wanted: bool) -> None:
    """Update a test quantity with what is left of a residual beyond its doubt; nu is the whole residual's."""
    left = slow.beyond(residual, doubt)
    take(s, c, place, left, wanted)
    if wanted and residual == residual:  # noqa: PLR0124 - not NaN
        s.cusum[place].total += abs(residual) - abs(left)
        s.cusum[place].squares += residual * residual - left * left


@kernel
def take(s: State, c: Const, place: int, residual: float, wanted: bool) -> None:
    """Update a test quantity, if it is to be updated and the residual is a number."""
    if wanted and residual == residual:  # noqa: PLR0124 - not NaN
        s.norm[place] = cusum.update(s.cusum[place], c.cusum[place], residual)


@kernel
def step(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Step T1, T6, and T2 and T5, which wait for gear changes that are to come.

    They need no speed of the vehicle, but a machine that is used: at rest no fault shows, and T would come down (V-C).
    """
    used = abs(u.I_em_sens) >= c.least_amps
    gear = int(u.gear)
    counts = used and u.u_c >= gate.ENGAGED and gear > 0
    v = s.corrected
    alignment.hold(v, u)
    if c.follows == 1:
        following.step(s, c, u, used, counts, dt)
    s.untested = following.untested(s, c, used)
    machine, battery = following.machine_known(s, c), following.battery_known(s, c)
    doubt2, doubt5, doubt6 = following.doubts(s, c, u) if used else (0.0, 0.0, 0.0)
    s.residual[R1] = t1.step(s.t1, c.t1, v, dt)
    volts = max(abs(u.U_em_ctrl), abs(u.U_em_sens))
    take_beyond(s, c, T1, s.residual[R1], following.voltage_doubt(s, c), volts >= c.least_volts)
    s.residual[R6] = t6.step(s.t6, s.q6, v, dt)
    take_beyond(s, c, T6, s.residual[R6], doubt6, used and battery)
    s.residual[R2] = t2.step(s.t2, s.q2, v, dt)
    s.residual[R5] = t5.step(s.t5, s.q5, v, dt)
    place = blanking.put(s.blanking, c.blank, gear, counts, s.residual[R2], s.residual[R5])
    s.doubts[(s.blanking.at - 1) % blanking.MOST, 0], s.doubts[(s.blanking.at - 1) % blanking.MOST, 1] = doubt2, doubt5
    if place >= 0:
        take_beyond(s, c, T2, s.blanking.held[place, 0], s.doubts[place, 0], machine and battery)
        take_beyond(s, c, T5, s.blanking.held[place, 1], s.doubts[place, 1], machine)
        s.use += dt
