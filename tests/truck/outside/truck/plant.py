"""A parallel hybrid truck of other make: own equations, parameters, gearbox, battery, driver; Heun's method, 2 ms.

16 t, machine geared 1.4 to the joint, 1.15 V s, 0.06 Ohm. The structure (machine behind the clutch) is what any monitor
of a parallel hybrid has to be told; nothing else is the shipped virtual ECU's. Drives: UDDS of the table in
cycles/, and own ones (jam, motorway).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from gateway_fdi.common.resources import shipped

#: What a user tells of it; keys of the structural model.
PARAMETERS = {
    "m_v0": 16000.0, "u_em": 1.4, "k_i": 1.15, "R_em": 0.06, "eta_em_0": 0.93, "c_em_f": 0.03, "J_em": 0.22, "J_c": 0.4,
    "J_e": 1.9, "u_f": 3.4, "r_w": 0.48, "C_d": 0.65, "A_f": 8.9, "C_r": 0.0065, "R_b": 0.03, "Q_b": 100000.0,
    "eta_e_i": 0.44, "N_cyl": 6.0, "B": 0.110, "S": 0.135, "p_me0_g": 1.4e4, "omega_e_idle": 65.0,
}  # fmt: skip
#: Its own gearbox and battery: ratios and inertias by gear, open circuit voltage over charge.
RATIOS = np.array([9.2, 7.1, 5.4, 4.1, 3.2, 2.5, 1.9, 1.45, 1.18, 0.95])
INERTIAS = np.array([0.25, 0.23, 0.21, 0.19, 0.18, 0.16, 0.15, 0.14, 0.13, 0.12])
CHARGE = np.array([0.0, 0.15, 0.3, 0.5, 0.7, 0.85, 1.0])
VOLTS = np.array([265.0, 290.0, 302.0, 310.0, 318.0, 327.0, 345.0])
#: The gearbox's loss at its input [Nm]: constant, per gear below the top one, per rad/s.
LOSS = (6.0, 0.5, 0.06)

#: Columns of what a drive gives, each 10 ms.
COLUMNS = (
    "U_em_ctrl", "ice_ctrl", "u_c", "gear", "T_b_ctrl", "alpha", "I_b", "U_em", "I_em", "omega_e", "omega_gb", "soc",
)  # fmt: skip


@dataclass(frozen=True)
class Truck:
    """How this truck differs from what is told of it: relative, reached after ``over_s`` (0: from the start on).

    ``creep_s``: how long its clutch slips after a gear change (0: it grabs).
    """

    resistance: float = 0.0
    torque_constant: float = 0.0
    battery_resistance: float = 0.0
    open_voltage: float = 0.0
    mass: float = 0.0
    over_s: float = 0.0
    creep_s: float = 0.0
    hills: float = 0.0


@dataclass(frozen=True)
class Fault:
    """``kind``: battery, inverter, efficiency, resistance (relative), sensor [V]; from ``at`` [s]."""

    kind: str
    size: float
    at: float


KINDS = ("battery", "inverter", "efficiency", "resistance", "sensor")


def speeds(name, seconds, rng):
    """Return the speed asked for [m/s], each 10 ms."""
    t = np.arange(round(seconds * 100)) * 0.01
    if name == "udds":
        table = np.loadtxt(shipped("cycles/udds.csv"), delimiter=",", skiprows=1)
        v = np.interp(t % table[-1, 0], table[:, 0], table[:, 1])
    else:
        top, rest = {"jam": (9.0, 6.0), "town": (14.0, 10.0), "motorway": (23.0, 2.0)}[name]
        times, values, at = [0.0], [0.0], 0.0
        while at < seconds:
            goal = rng.uniform(0.3, 1.0) * top
            for span, value in (
                (max(goal, 2.0) / 0.6, goal),
                (rng.uniform(10, 60), goal),
                (goal / 0.7 + 4, rng.choice([0.0, 0.5 * goal])),
                (rng.uniform(1, rest), 0.0 if name != "motorway" else 0.6 * goal),
            ):
                at += span
                times.append(at)
                values.append(values[-1] if span < 2.0 else value)
        v = np.interp(t, times, values)
    return np.convolve(v, np.ones(150) / 150.0, mode="same")


@njit(cache=True)
def _interp(x, y, at):
    if at <= x[0]:
        return y[0]
    for k in range(1, len(x)):
        if at < x[k]:
            return y[k - 1] + (y[k] - y[k - 1]) * (at - x[k - 1]) / (x[k] - x[k - 1])
    return y[-1]


@njit(cache=True)
def _friction(w):
    # e3 of the model, with this engine's stroke and bore; its constants are common knowledge of the class of engines.
    return 1.44e5 * (0.46 + 9.1e-4 * 0.135**2 * w * w) * 1.8 * (0.075 / 0.110) ** 0.5


@njit(cache=True)
def _drive(asked, q, drift, faults, hills, creep_s, soc, ratios, inertias, charge, volts, out):
    m0, u_em, k0, r0, eta0, cf, j_em, j_c, j_e, u_f, r_w = (
        q[0],
        q[1],
        q[2],
        q[3],
        q[4],
        q[5],
        q[6],
        q[7],
        q[8],
        q[9],
        q[10],
    )
    c_d, a_f, c_r, rb0, q_b, eta_e, idle = q[11], q[12], q[13], q[14], q[15], q[16], q[17]
    n_cyl, bore, stroke, p_g = 6.0, 0.110, 0.135, 1.4e4
    volume = n_cyl * stroke * bore**2
    v, w_e, gear, shift, dwell, integral, locked = 0.0, idle, 3, 0.0, 0.0, 0.0, False
    wanted, t_em_old, t_e_old, brake, way, since = 3, 0.0, 0.0, 0.0, 0.0, 9.0
    dt = 0.01
    for k in range(len(asked)):
        rise = drift[k]
        mass = m0 * (1.0 + rise[4])
        k_i, r_em = k0 * (1.0 + rise[1]), r0 * (1.0 + rise[0])
        w_w = v / r_w
        neutral = shift > 0.3
        ratio = ratios[gear - 1]
        w_gb = w_w * u_f
        w_mj = ratio * w_gb
        # Driver.
        error = asked[k] - v
        ahead = asked[min(k + 50, len(asked) - 1)]
        integral = min(max(integral + error * dt, -3.0), 3.0)
        want = (
            mass * (0.9 * error + 0.15 * integral + (ahead - asked[k]) / 0.5) * r_w
            + 0.5 * 1.2 * c_d * a_f * v * v * r_w
        )
        want += mass * 9.81 * c_r * r_w * (1.0 if v > 0.1 else 0.0)
        at_joint = want / (ratio * u_f)
        # Gears.
        dwell += dt
        since += dt
        if shift > 0.0:
            shift -= dt
            if shift <= 0.5 and gear != wanted:
                gear = wanted
            if shift <= 0.0:
                shift, dwell, since = 0.0, 0.0, 0.0
        elif dwell > 1.5:
            if w_mj > 150.0 and gear < len(ratios):
                high = gear + 1
                while high < len(ratios) and ratios[high - 1] * w_gb > 130.0:
                    high += 1
                wanted, shift, locked = high, 0.8, False
            elif w_mj < 85.0 and gear > 3:
                low = gear - 1
                while low > 3 and ratios[low - 1] * w_gb < 90.0:
                    low -= 1
                wanted, shift, locked = low, 0.8, False
        ratio = ratios[gear - 1]
        w_mj = ratio * w_gb
        engage = shift == 0.0 and w_mj > idle + 6.0
        if not engage:
            locked = False
        # Torques: the machine helps, brakes and drives off; the charge is kept.
        limit = min(260.0 * k_i, 45000.0 / max(w_mj * u_em, 30.0)) * u_em
        share = min(max(0.35 + 4.0 * (soc - 0.5), -0.2), 0.7)
        t_em, t_e = 0.0, 0.0
        if shift == 0.0:
            if at_joint < 0.0:
                t_em = max(at_joint, -limit)
            elif not engage:
                t_em = min(at_joint, limit)
            else:
                t_em = min(max(share * at_joint - (25.0 if soc < 0.45 else 0.0), -limit), limit)
                t_e = min(max(at_joint - t_em, 0.0), 1100.0)
        if v < 0.3 and asked[k] < 0.3:
            t_em, t_e = 0.0, 0.0
        t_em_old += (t_em - t_em_old) * min(dt / 0.08, 1.0)
        t_e_old += (t_e - t_e_old) * min(dt / 0.10, 1.0)
        if shift > 0.0:
            t_em_old, t_e_old = t_em_old * 0.7, t_e_old * 0.7
        if neutral:
            t_em_old, t_e_old = 0.0, 0.0
        negative = want - (t_em_old + t_e_old) * ratio * u_f
        brake = 0.0
        if (want < 0.0 and negative < 0.0) or (asked[k] < 0.3 and v < 1.0):
            brake = min(-negative if negative < 0.0 else 0.0, 0.6 * mass * 9.81 * r_w) + (
                3000.0 if v < 0.5 and asked[k] < 0.3 else 0.0
            )
        brake = round(brake)
        # Engine: torque to fuel energy of a cycle, as the engine's own map has it.
        clutch = 1.0 if engage else 0.0
        if not engage:
            t_e_old = 0.0
        p_me = 16.0 * t_e_old / volume
        ice = max((p_me + _friction(w_e) + p_g) * n_cyl * np.pi * stroke * bore**2 / (4.0 * eta_e), 0.0)
        ice = 2.0 * round(ice / 2.0)
        torque_e = (ice * 4.0 * eta_e / (n_cyl * np.pi * stroke * bore**2) - _friction(w_e) - p_g) * volume / 16.0
        # Machine: voltage asked for so that the current makes the torque, as far as its controller knows.
        w_em = u_em * w_mj
        eta = eta0 * (1.0 + faults[k, 2])
        i = (t_em_old / u_em + cf * w_em) / k_i
        i = i / eta0 if i > 0.0 else i * eta0
        u_ask = 0.02 * round((k0 * w_em + r0 * i) / 0.02)
        if neutral or (v < 0.05 and asked[k] < 0.3):
            u_ask = 0.02 * round(k_i * w_em / (1.0 + faults[k, 1]) / 0.02)
        u_act = (1.0 + faults[k, 1]) * u_ask
        i = (u_act - k_i * w_em) / (r_em * (1.0 + faults[k, 3]))
        # An inner loop keeps the current within its limits.
        if abs(i) > 320.0 or (shift > 0.0 and abs(i) > 3.0):
            i = min(max(i, -320.0), 320.0) if shift == 0.0 else 0.0
            u_ask = 0.02 * round((k_i * w_em + r_em * (1.0 + faults[k, 3]) * i) / (1.0 + faults[k, 1]) / 0.02)
            u_act = (1.0 + faults[k, 1]) * u_ask
            i = (u_act - k_i * w_em) / (r_em * (1.0 + faults[k, 3]))
        torque_m = i * k_i * (eta if i > 0.0 else 1.0 / eta) - cf * w_em
        u_oc = _interp(charge, volts, soc) * (1.0 + rise[3])
        r_b = rb0 * (1.0 + rise[2])
        power = i * u_act / (1.0 + faults[k, 0])
        i_b = (u_oc - max(u_oc * u_oc - 4.0 * r_b * power, 0.0) ** 0.5) / (2.0 * r_b)
        soc -= dt * i_b / q_b
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = u_ask, ice, clutch, 0 if neutral else gear
        out[k, 4], out[k, 5], out[k, 6], out[k, 7], out[k, 8] = brake, 0.0, i_b, u_act, i
        out[k, 9], out[k, 10], out[k, 11] = w_e, w_gb, soc
        slip = w_e - w_mj
        # Motion, 5 steps of Heun's method.
        h = dt / 5.0
        for _ in range(5):
            first, second = 0.0, 0.0
            trial = v
            for stage in range(2):
                w = trial / r_w
                mj = ratio * u_f * w
                inertia = mass * r_w**2
                slope = hills * np.sin(way / 95.0)
                roll = mass * 9.81 * c_r * r_w
                net = -0.5 * 1.2 * c_d * a_f * trial * trial * r_w - max(-roll, min(roll, 1000.0 * w)) - brake
                net -= mass * 9.81 * r_w * np.sin(slope)
                if not neutral:
                    joint = torque_m * u_em + (torque_e if engage else 0.0)
                    loss = 6.0 + 0.5 * (len(ratios) - gear) + 0.06 * mj
                    through = joint - loss
                    net += through * (0.97 if through > 0.0 else 1.0 / 0.97) * ratio * u_f
                    inertia += (inertias[gear - 1] + j_em * u_em**2 + (j_c + j_e if locked else 0.0)) * (
                        ratio * u_f
                    ) ** 2
                slope_v = net / inertia * r_w
                if stage == 0:
                    first = slope_v
                    trial = max(v + h * first, 0.0)
                else:
                    second = slope_v
            v = max(v + 0.5 * h * (first + second), 0.0)
            way += h * v
        w_mj = ratio * u_f * v / r_w
        if locked:
            w_e = w_mj
        elif engage:
            lag = 0.10 if creep_s == 0.0 or abs(slip) > 2.8 else creep_s
            w_e = w_mj + slip * (1.0 - dt / lag)
            if abs(w_e - w_mj) < 0.4:
                locked, w_e = True, w_mj
        else:
            target = idle if shift == 0.0 or wanted == 0 else max(idle, ratios[wanted - 1] * w_gb)
            w_e += (target - w_e) * dt / 0.25


def drive(cycle, seconds, rng, truck=Truck(), faults=()):
    """Return a drive, one row each 10 ms, the columns as in COLUMNS; true values, not what sensors read."""
    asked = speeds(cycle, seconds, rng)
    t = np.arange(len(asked)) * 0.01
    reached = np.ones(len(t)) if truck.over_s == 0.0 else np.minimum(t / truck.over_s, 1.0)
    sizes = (truck.resistance, truck.torque_constant, truck.battery_resistance, truck.open_voltage, truck.mass)
    drift = reached[:, None] * np.array(sizes)
    drift[:, 4] = truck.mass  # a load is there or not
    given = np.zeros((len(t), len(KINDS)))
    for fault in faults:
        given[t >= fault.at, KINDS.index(fault.kind)] = fault.size
    p = PARAMETERS
    names = (
        "m_v0",
        "u_em",
        "k_i",
        "R_em",
        "eta_em_0",
        "c_em_f",
        "J_em",
        "J_c",
        "J_e",
        "u_f",
        "r_w",
        "C_d",
        "A_f",
        "C_r",
    )
    q = np.array([p[name] for name in (*names, "R_b", "Q_b", "eta_e_i", "omega_e_idle")])
    out = np.zeros((len(t), len(COLUMNS)))
    _drive(asked, q, drift, given, truck.hills, truck.creep_s, 0.55, RATIOS, INERTIAS, CHARGE, VOLTS, out)
    return out, given
