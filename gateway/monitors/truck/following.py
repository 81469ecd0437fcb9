"""Which sets tell of warmth and age (:mod:`.slow`), and what the tests take of it.

A set does while the machine is used; for the machine while the clutch holds and no gear change is near; for the battery
always. Behind the learning none does while a test has fired, or T1 is on its way: then U_ctrl
or U_sens is not the machine's voltage.
"""

from __future__ import annotations

from math import sqrt

from gateway.fdi.structure.generator.runtime import interpolate
from gateway.jit import kernel
from gateway.monitors.truck import slow
from gateway.monitors.truck.messages import Inputs
from gateway.monitors.truck.records import T1, Const, State

#: Bits of ``untested``: the machine's R and k are not known yet (T2, T5); the battery's R and U are not (T2, T6); the
#: machine is not used (T2, T5, T6); the clutch does not hold (T3, T4, T7; T2 and T5 where it is open).
MACHINE, BATTERY, IDLE, CLUTCH = 1, 2, 4, 8
#: T_norm of T1 from which on nothing is followed.
DOUBTED = 0.3
#: Time without use after which nothing is known better for waiting [s].
LONG = 300.0


@kernel
def machine_known(s: State, c: Const) -> bool:
    """Tell whether T2 and T5 can be tested."""
    return bool(c.follows == 0 or s.machine.known == 1)


@kernel
def battery_known(s: State, c: Const) -> bool:
    """Tell whether T2 and T6 can be tested."""
    return bool(c.follows == 0 or s.battery.known == 1)


@kernel
def _machine(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Follow the machine's resistance and torque constant."""
    q = c.t2
    ratio = interpolate(q.f_3_x, q.f_3_y, u.gear) * q.u_em
    back, drop = q.k_i * ratio * u.omega_gb_sens, q.R_em * u.I_em_sens
    speed = q.k_i * ratio * c.speed_noise
    noise = sqrt(c.voltage_noise * c.voltage_noise + speed * speed)
    slow.follow(s.machine, c.machine, u.U_em_ctrl - back - drop, drop, back, noise, dt, min(s.machine_waited, LONG))
    s.machine_waited = 0.0


@kernel
def _battery(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Follow the battery's open circuit voltage and resistance."""
    q = c.t6
    open_volts = interpolate(q.f_1_x, q.f_1_y, s.t6.SoC)
    first, second = open_volts * u.I_b_sens, -q.R_b * u.I_b_sens * u.I_b_sens
    rest = u.I_em_sens * u.U_em_sens - first - second
    slow.follow(s.battery, c.battery, rest, first, second, c.power_noise, dt, min(s.battery_waited, LONG))
    s.battery_waited = 0.0


@kernel
def step(s: State, c: Const, u: Inputs, used: bool, counts: bool, dt: float) -> None:
    """Take a set, and put what is found into the constants of T2, T5 and T6.

    Args:
        s: state.
        c: constants.
        u: inputs.
        used: the machine is.
        counts: the clutch holds, too.
        dt: since the set before [s].
    """
    s.machine_waited += dt
    s.battery_waited += dt
    if not used:
        return
    # What is not known yet is learned all the same: a fault that is there from the start lies beyond the bounds, or is
    # not seen.
    calm = s.fired == 0 and s.norm[T1] <= DOUBTED
    if counts and s.blanking.quiet == 0 and int(u.gear) == s.blanking.gear and (calm or s.machine.known == 0):
        _machine(s, c, u, dt)
    if calm or s.battery.known == 0:
        _battery(s, c, u, dt)
    more, torque = 1.0 + s.machine.taken[0], 1.0 + s.machine.taken[1]
    s.q2.R_em, s.q2.k_i = c.t2.R_em * more, c.t2.k_i * torque
    s.q5.R_em, s.q5.k_i = s.q2.R_em, s.q2.k_i
    s.winding, s.magnets, s.open_volts, s.cells = more - 1.0, torque - 1.0, s.battery.taken[0], s.battery.taken[1]
    volts = 1.0 + s.battery.taken[0]
    s.q2.R_b = s.q6.R_b = c.t6.R_b * (1.0 + s.battery.taken[1])
    for k in range(len(s.q6.f_1_y)):
        s.q2.f_1_y[k] = s.q6.f_1_y[k] = c.t6.f_1_y[k] * volts


@kernel
def doubts(s: State, c: Const, u: Inputs) -> tuple[float, float, float]:
    """Return what is not known of T2 [A], T5 [rad/s] and T6 [A] because of warmth and age, standard deviations."""
    if c.follows == 0:
        return 0.0, 0.0, 0.0
    q = s.q2
    ratio = interpolate(q.f_3_x, q.f_3_y, u.gear) * q.u_em
    volts = slow.doubt(s.machine, q.R_em * u.I_em_sens, q.k_i * ratio * u.omega_gb_sens)
    open_volts = interpolate(q.f_1_x, q.f_1_y, s.t6.SoC)
    power = slow.doubt(s.battery, open_volts * u.I_b_sens, -q.R_b * u.I_b_sens * u.I_b_sens)
    current = power / max(open_volts - q.R_b * u.I_b_sens, 1.0)
    by_machine = volts * abs(u.I_em_sens) / max(open_volts - q.R_b * u.I_b_sens, 1.0)
    speed = volts / (q.k_i * ratio) if ratio > 0.0 else 0.0
    return sqrt(current * current + by_machine * by_machine), speed, current


@kernel
def untested(s: State, c: Const, used: bool) -> int:
    """Return why tests are not at work, as bits."""
    bits = 0 if machine_known(s, c) else MACHINE
    if not battery_known(s, c):
        bits |= BATTERY
    if not used:
        bits |= IDLE
    if s.watched == 0:
        bits |= CLUTCH
    return bits
