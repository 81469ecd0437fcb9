"""Driver, gear shifts, clutch and energy management of the truck, 10 ms a step.

The driver looks a second ahead. Engine and machine share what is asked for: the machine brakes as far as it may,
assists above a share of the engine's torque, and charges a battery that is low. Its current is controlled in a closed
loop, so that the truck follows the cycle with any of the paper's faults: with an open loop half a voltage would brake
hard.
"""

from __future__ import annotations

from typing import Any

from gateway_fdi.jit import f8, i8, kernel, record
from gateway_fdi.structure.generator.runtime import interpolate
from gateway_plants.truck.ecu.plant import engine_torque, fuel_for, resistance

#: Length of a step [s].
PERIOD = 0.01
#: Driver: gains [1/s], [1/s2]; bound of the integral [m/s].
GAIN, INTEGRAL, BOUND = 0.8, 0.3, 3.0
#: Length of a shift, and least time between two [s].
SHIFT, BETWEEN = 0.8, 0.8
#: Engine speeds [rad/s]: shift up beyond, in a hurry beyond, down below; a new gear gives at least.
HURRY, STRONG = 220.0, 130.0
UP, DOWN, LEAST = 165.0, 85.0, 100.0
#: Machine: power [W], current [A]; share of the engine's torque beyond which it assists.
POWER, CURRENT, ASSIST = 59e3, 320.0, 0.22
#: State of charge: assists fully from, not below; charges below; brakes with the machine below.
FULL, EMPTY, LOW, HIGH = 0.50, 0.40, 0.47, 0.75
#: Torque of the machine that charges [Nm], share of R_em that the current loop integrates in a step.
CHARGE, LOOP = 150.0, 0.3
#: Greatest fuel energy of a cycle [J]; brake torque that holds a truck [Nm].
MOST_FUEL, HOLD = 70e3, 3000.0
#: Below this speed asked for and driven a truck stands [m/s].
STANDS = 0.15

STATE = record(gear=i8, next=i8, shifting=f8, since=f8, integral=f8, volts=f8, current=f8)


@kernel
def _choose(c: Any, s: Any, omega_gb: float, torque: float) -> int:
    """Return the gear for a speed of the gearbox's output and a torque asked for there [Nm]."""
    speed = omega_gb * c.ratio[s.gear - 1]
    # Each shift costs 0.8 s without torque: a driver in a hurry revs higher.
    hurry = torque / c.ratio[s.gear - 1] > 0.5 * interpolate(c.speed_x, c.torque_y, speed)
    up = HURRY if hurry else UP
    if DOWN <= speed <= up or s.since < BETWEEN:
        return int(s.gear)
    highest, lowest = (12, s.gear + 1) if speed > up else (s.gear - 1, 1)
    best = 0
    for gear in range(highest, lowest - 1, -1):
        at = omega_gb * c.ratio[gear - 1]
        if at < LEAST:
            continue
        if torque / c.ratio[gear - 1] <= 0.9 * interpolate(c.speed_x, c.torque_y, at):
            return gear
        # None is strong enough: up to where the engine still has most of its power, down to the first that revs.
        if best == 0 or (at <= STRONG and speed > up) or speed < DOWN:
            best = gear
    if best > 0:
        return best
    return int(s.gear) if speed > up else 1


@kernel
def _split(c: Any, torque: float, most: float, least: float, soc: float, limit: float) -> float:
    """Return the machine's share of a torque at the joint [Nm].

    Args:
        c: constants of the plant.
        torque: asked for.
        most: greatest torque of the engine.
        least: its drag.
        soc: state of charge.
        limit: greatest torque of the machine.
    """
    if torque < least:
        return max(torque - least, -limit) if soc < HIGH else 0.0
    full = min(max((soc - EMPTY) / (FULL - EMPTY), 0.0), 1.0)
    share = full * max(torque - ASSIST * most, 0.0)
    if soc < LOW and torque > 0.0:
        share -= CHARGE * min((LOW - soc) / 0.02, 1.0)
    return min(max(share, -limit), limit)


@kernel
def _asked_torque(c: Any, p: Any, s: Any, now: float, ahead: float, stands: bool) -> float:
    """Return the torque at the wheels that the driver asks for [Nm]; arguments as of :func:`control`."""
    v = p.omega_w * c.r_w
    error = now - v
    if stands:
        s.integral = 0.0
    else:
        s.integral = min(max(s.integral + PERIOD * error, -BOUND), BOUND)
    mass = c.m_v0 - p.fuel
    inertia = c.ratio[s.gear - 1] ** 2 * (c.inertia[s.gear - 1] + c.J_em + c.J_c + c.J_e) * c.u_f**2
    push = (ahead - now) + GAIN * error + INTEGRAL * s.integral
    wheel = push * (mass * c.r_w**2 + inertia) / c.r_w
    # The driver does not feel the wind.
    wheel += resistance(c, p.omega_w, mass) - 0.5 * c.rho * c.C_d * c.A_f * c.r_w * (
        (v + c.wind) * abs(v + c.wind) - v * v
    )
    return float(wheel)


@kernel
def _shift(c: Any, s: Any, omega_gb: float, wheel: float, stands: bool) -> None:
    """Go on with a shift, or begin one if another gear suits the torque at the wheels [Nm] better."""
    if s.shifting > 0.0:
        s.shifting -= PERIOD
        if s.shifting <= SHIFT / 2.0:
            s.gear = s.next
        if s.shifting <= 1e-9:
            s.shifting, s.since = 0.0, 0.0
    elif not stands:
        wanted = _choose(c, s, omega_gb, max(wheel, 0.0) / c.u_f)
        if wanted != s.gear:
            s.next, s.shifting = wanted, SHIFT


@kernel
def _propel(c: Any, p: Any, s: Any, omega_mj: float, wheel: float, u: Any) -> float:
    """Share a torque at the wheels [Nm] between engine, machine and brake, in gear; returns the machine's [Nm].

    Args:
        c: constants of the plant.
        p: its state.
        s: state of the controller.
        omega_mj: speed of the joint of engine and machine [rad/s].
        wheel: torque at the wheels [Nm].
        u: commands: clutch, and brake and fuel if they are needed, are written.
    """
    ratio = c.ratio[s.gear - 1]
    loss = 8.0 + 0.6 * (12 - s.gear) + 0.08 * omega_mj
    through = wheel / (c.u_f * ratio)
    torque = through / (c.eta_pos if through > 0.0 else c.eta_neg) + loss
    running = omega_mj >= c.omega_e_idle
    u.clutch = 1.0 if running else 0.9
    if not running and torque < 0.0:
        u.clutch = 0.0
    most = interpolate(c.speed_x, c.torque_y, p.omega_e)
    least = engine_torque(c, 0.0, p.omega_e) if u.clutch > 0.995 else 0.0
    limit = min(POWER / max(omega_mj, 1.0), CURRENT * c.k_i * c.eta_em_0)
    machine = _split(c, torque, most, least, p.soc, limit)
    if omega_mj < 10.0:
        machine = max(machine, 0.0)
    engine = min(max(torque - machine, least), most)
    if u.clutch > 0.0:
        wanted_fuel = fuel_for(c, engine / u.clutch, p.omega_e)
        u.ice = min(max(wanted_fuel, 0.0), MOST_FUEL)
    missing = torque - machine - engine
    if missing < 0.0:
        u.brake = -missing * ratio * c.u_f * c.eta_neg
    return float(machine)


@kernel
def _control_current(c: Any, s: Any, omega_em: float, machine: float, current: float) -> float:
    """Return the machine's voltage [V]: what the model says, and what it is wrong by, integrated.

    Args:
        c: constants of the plant.
        s: state of the controller.
        omega_em: speed of the machine [rad/s].
        machine: torque asked of it [Nm].
        current: measured [A].
    """
    wanted_torque = machine + c.c_em_f * omega_em
    k_a = c.k_i * (c.eta_em_0 if wanted_torque > 0.0 else 1.0 / c.eta_em_0)
    reference = min(max(wanted_torque / k_a, -CURRENT), CURRENT)
    s.volts += LOOP * c.R_em * (s.current - current)
    s.current = reference
    return float(c.k_i * omega_em + c.R_em * reference + s.volts)


@kernel
def control(c: Any, p: Any, s: Any, now: float, ahead: float, current: float, u: Any) -> None:
    """Compute the commands of a step.

    Args:
        c: constants of the plant.
        p: its state.
        s: state of the controller.
        now: speed asked for [m/s].
        ahead: speed asked for a second later [m/s].
        current: of the machine, measured [A].
        u: commands, written.
    """
    v, omega_gb = p.omega_w * c.r_w, p.omega_w * c.u_f
    u.brake, u.ice = 0.0, 0.0
    s.since += PERIOD
    stands = now < STANDS and ahead < STANDS and v < 0.5
    wheel = _asked_torque(c, p, s, now, ahead, stands)
    _shift(c, s, omega_gb, wheel, stands)
    omega_mj = c.ratio[s.gear - 1] * omega_gb
    u.gear = s.gear
    machine = 0.0
    if stands:
        u.clutch, u.brake = 0.0, HOLD
    elif s.shifting > 0.0:
        u.clutch = 0.0
        if wheel < 0.0:
            u.brake = -wheel
    else:
        machine = _propel(c, p, s, omega_mj, wheel, u)
    if u.clutch == 0.0:
        u.ice = max(fuel_for(c, 0.0, p.omega_e), 0.0)  # idles
    u.volts = _control_current(c, s, c.u_em * omega_mj, machine, current)
