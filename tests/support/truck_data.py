"""The truck of paper 004 driven open loop, and its residuals T1 to T7, all by hand from the equations."""

from math import pi, sin, sqrt

import numpy as np

P = {
    "q_LHV": 42.5e6, "eta_e_i": 0.45, "N_cyl": 6.0, "B": 0.130, "S": 0.160, "p_me0_g": 1.5e4, "k_1": 1.44e5,
    "k_2": 0.46,
    "k_3": 9.1e-4, "k_4": 0.075, "Pi_bl": 1.8, "Q_b": 119520.0, "R_b": 0.023, "k_i": 1.0, "R_em": 0.05, "eta": 0.95,
    "c_em_f": 0.02, "J_em": 0.3, "J_c": 0.5, "J_e": 2.5, "eta_pos": 0.97, "eta_neg": 1 / 0.97, "u_f": 2.92,
    "m_v0": 20000.0, "drag": 0.5 * 1.2 * 0.6 * 9.7, "C_r": 0.006, "r_w": 0.5, "g": 9.81,
}  # fmt: skip
U_OC = [200.0, 228.0, 237.0, 243.0, 247.0, 250.0, 253.0, 257.0, 262.0, 268.0, 280.0]
J_GB = [0.30, 0.28, 0.26, 0.24, 0.22, 0.21, 0.20, 0.19, 0.18, 0.17, 0.16, 0.15]
U_GB = [11.27, 9.14, 7.17, 5.81, 4.62, 3.75, 3.01, 2.44, 1.91, 1.55, 1.23, 1.00]
DT = 0.01


def open_voltage(soc):
    return float(np.interp(soc, np.linspace(0, 1, 11), U_OC))


def engine_torque(ice, omega_e):
    friction = P["k_1"] * (P["k_2"] + P["k_3"] * P["S"] ** 2 * omega_e**2) * P["Pi_bl"] * sqrt(P["k_4"] / P["B"])
    mean = ice * 4 * P["eta_e_i"] / (P["N_cyl"] * pi * P["S"] * P["B"] ** 2) - friction - P["p_me0_g"]
    return mean * P["N_cyl"] * P["S"] * P["B"] ** 2 / 16


def acceleration(z, i_em, omega_w, omega_mj, omega_e, m_f):
    """Of the wheels [rad/s2]: e9, e10, e12, e14, e15, e17 to e22, e24 to e30."""
    gear = int(z["gear"])
    k_a = P["k_i"] * (P["eta"] if i_em > 0 else 1 / P["eta"] if i_em < 0 else 1.0)
    t_em = i_em * k_a - P["c_em_f"] * omega_mj
    t_mj = t_em + z["u_c"] * engine_torque(z["ice_ctrl"], omega_e)
    loss = 8 + 0.6 * (12 - gear) + 0.08 * omega_mj
    ratio = U_GB[gear - 1]
    t_gb = (t_mj - loss) * (P["eta_pos"] if t_mj > loss else P["eta_neg"]) * ratio
    j_tot = ratio**2 * (J_GB[gear - 1] + P["J_em"] + P["J_c"] + P["J_e"])
    mass = P["m_v0"] - m_f
    roll = mass * P["g"] * P["C_r"] * P["r_w"]
    resist = P["drag"] * omega_w**2 * P["r_w"] ** 3 + max(-roll, min(roll, 1000 * omega_w))
    slope = mass * P["g"] * P["r_w"] * sin(z["alpha"])
    return (t_gb * P["u_f"] - resist - z["T_b_ctrl"] - slope) / (j_tot * P["u_f"] ** 2 + mass * P["r_w"] ** 2)


def drive(seconds, seed, *, noise=0.0, f_R=0.0, f_pe=0.0, f_eta=0.0):
    """Signals of the bus at 10 ms, list of dictionaries; Euler at 10 ms, so that healthy data fit the residuals."""
    rng = np.random.default_rng(seed)
    omega_w, m_f, soc = 25.0, 0.0, 0.5
    rows = []
    for k in range(int(seconds / DT)):
        t = k * DT
        gear = 9 + int(t / 20) % 4
        ratio = U_GB[gear - 1]
        omega_gb = omega_w * P["u_f"]
        omega_mj = omega_gb * ratio
        z = {
            "gear": float(gear), "u_c": 1.0, "alpha": 0.004 * sin(0.07 * t), "T_b_ctrl": max(0.0, 900 * sin(0.11 * t)),
            "ice_ctrl": 14000 + 5000 * sin(0.2 * t), "U_em_ctrl": P["k_i"] * omega_mj + 6 * sin(0.3 * t) + 0.5,
        }  # fmt: skip
        u_em = (1 + f_pe) * z["U_em_ctrl"]
        i_em = (u_em - P["k_i"] * omega_mj) / (P["R_em"] * (1 + f_R))
        u_oc = open_voltage(soc)
        i_b = (u_oc - sqrt(u_oc**2 - 4 * P["R_b"] * i_em * u_em)) / (2 * P["R_b"])  # e6 in e11, the smaller root
        z |= {
            "I_b_sens": i_b, "I_em_sens": i_em, "U_em_sens": u_em, "omega_e_sens": omega_mj, "omega_gb_sens": omega_gb,
        }  # fmt: skip
        for name in ("I_b_sens", "I_em_sens", "U_em_sens", "omega_e_sens", "omega_gb_sens"):
            z[name] += noise * rng.normal()
        rows.append(z)
        i_felt = i_em * ((1 + f_eta) ** np.sign(i_em))
        omega_w += DT * acceleration(z | {"omega": 0}, i_felt, omega_w, omega_mj, omega_mj, m_f)
        m_f += DT * z["ice_ctrl"] * omega_mj / (4 * pi * P["q_LHV"])
        soc += DT * -i_b / P["Q_b"]
    return rows


def t1(rows):
    return [z["U_em_sens"] - z["U_em_ctrl"] for z in rows]


def t2(rows):
    soc, found = 0.5, []
    for z in rows:
        omega_em = U_GB[int(z["gear"]) - 1] * z["omega_gb_sens"]
        voltage = z["I_em_sens"] * P["R_em"] + P["k_i"] * omega_em
        found.append(z["I_b_sens"] - z["I_em_sens"] * voltage / (open_voltage(soc) - P["R_b"] * z["I_b_sens"]))
        soc -= DT * z["I_b_sens"] / P["Q_b"]
    return found


def t5(rows):
    return [
        z["omega_gb_sens"] - (z["U_em_ctrl"] - P["R_em"] * z["I_em_sens"]) / (P["k_i"] * U_GB[int(z["gear"]) - 1])
        for z in rows
    ]


def t6(rows):
    soc, found = 0.5, []
    for z in rows:
        battery = open_voltage(soc) - P["R_b"] * z["I_b_sens"]
        found.append(z["I_b_sens"] - z["I_em_sens"] * z["U_em_sens"] / battery)
        soc -= DT * z["I_b_sens"] / P["Q_b"]
    return found


def currents(rows, test):
    soc, found = 0.5, []
    for z in rows:
        omega_em = U_GB[int(z["gear"]) - 1] * z["omega_gb_sens"]
        if test == "T7":
            found.append(z["I_em_sens"])
        elif test == "T3":
            found.append((z["U_em_ctrl"] - P["k_i"] * omega_em) / P["R_em"])
        else:
            found.append(z["I_b_sens"] * (open_voltage(soc) - P["R_b"] * z["I_b_sens"]) / z["U_em_sens"])
        soc -= DT * z["I_b_sens"] / P["Q_b"]
    return found


def integral(rows, test):
    """T3, T4 of ICDS and T7 [rad/s], (36)."""
    omega_w, m_f, found = rows[0]["omega_gb_sens"] / P["u_f"], 0.0, []
    for z, i_em in zip(rows, currents(rows, test), strict=True):
        found.append(z["omega_gb_sens"] - P["u_f"] * omega_w)
        omega_mj = U_GB[int(z["gear"]) - 1] * z["omega_gb_sens"]
        omega_w += DT * acceleration(z, i_em, omega_w, omega_mj, z["omega_e_sens"], m_f)
        m_f += DT * z["ice_ctrl"] * z["omega_e_sens"] / (4 * pi * P["q_LHV"])
    return found


def mixed(rows, test, alpha):
    """T3, T4 of MCDS [rad/s2], (32) for the wheels: the pulse response of the filter on what is left of each sample."""
    m_f, left = 0.0, [0.0]
    for z, after, i_em in zip(rows, rows[1:], currents(rows, test), strict=False):
        omega_w, next_w = z["omega_gb_sens"] / P["u_f"], after["omega_gb_sens"] / P["u_f"]
        omega_mj = U_GB[int(z["gear"]) - 1] * z["omega_gb_sens"]
        felt = acceleration(z, i_em, omega_w, omega_mj, z["omega_e_sens"], m_f)
        left.append((next_w - omega_w) / DT - felt)
        m_f += DT * z["ice_ctrl"] * z["omega_e_sens"] / (4 * pi * P["q_LHV"])
    return low_pass(left, alpha, DT)


def low_pass(signal, alpha, dt):
    """Response of alpha / (p + alpha) to a signal that is held over the sample before."""
    decay = np.exp(-alpha * dt)
    return np.convolve(signal, (1 - decay) * decay ** np.arange(len(signal)))[: len(signal)]
