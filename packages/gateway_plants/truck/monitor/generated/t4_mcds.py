"""Residual generator T4_MCDS of truck: made from its model, not by hand.

Consistency relation e30: der(omega_w) = T_net / (J_tot * u_f**2 + m_v * r_w**2)
Sequence ({omega_e}, {e36}), ({m_f}, {e1}), ({p_f}, {e3}), ({T_e}, {e2}), ({I_b}, {e33}), ({SoC}, {e4}), ({U_oc}, {e5}), ({U_b}, {e6}), ({U_em}, {e34}), ({I_em}, {e11}), ({k_a}, {e9}), ({u_gb}, {e18}), ({omega_gb}, {e37}), ({omega_mj}, {e23}), ({omega_em}, {e16}), ({T_em}, {e10}), ({T_c}, {e12}), ({T_mj}, {e14}), ({J_mj}, {e15}), ({J_gb}, {e17}), ({T_gbl}, {e20}), ({eta_gb}, {e19}), ({T_gb}, {e21}), ({J_tot}, {e22}), ({m_v}, {e24}), ({omega_w}, {e32}), ({T_d}, {e25}), ({T_r}, {e26}), ({T_g}, {e27}), ({T_b}, {e28}), ({T_net}, {e29})
"""

from math import sin, exp, isfinite, pi, nan
from typing import Annotated, Any

from gateway_fdi.structure.generator.runtime import interpolate, root, sign
from gateway_fdi.jit import Record, f8, f8s, kernel, means


class State(Record):
    SoC: f8 = means('state of charge')
    d_SoC: f8 = means('derivative of SoC', '1/s')
    m_f: f8 = means('fuel consumed', 'kg')
    d_m_f: f8 = means('derivative of m_f', 'kg/s')
    filtered_: f8 = means('residual by (20)')
    last_: f8 = means('omega_w at the sample before', 'rad/s')
    drive_: f8 = means('b of (20) at the sample before')


class Const(Record):
    q_LHV: f8 = means('lower heating value of the fuel', 'J/kg')
    eta_e_i: f8 = means('efficiency of the engine, indicated')
    N_cyl: f8 = means('cylinders of the engine')
    B: f8 = means('bore', 'm')
    S: f8 = means('stroke', 'm')
    p_me0_g: f8 = means("mean effective pressure of the engine's gas exchange", 'Pa')
    k_1: f8 = means('friction of the engine, e3', 'Pa')
    k_2: f8 = means('friction of the engine, e3: at rest')
    k_3: f8 = means('friction of the engine, e3: with speed', 's2/m2')
    k_4: f8 = means('friction of the engine, e3: with the bore', 'm')
    Pi_bl: f8 = means('friction of the engine, e3: a factor')
    Q_b: f8 = means('charge of the battery', 'As')
    R_b: f8 = means('inner resistance of the battery', 'ohm')
    k_i: f8 = means('torque constant of the machine without losses', 'V s/rad')
    eta_em_0: f8 = means('efficiency of the machine')
    c_em_f: f8 = means('friction of the machine', 'Nm s/rad')
    u_em: f8 = means('ratio of the machine to the joint')
    J_em: f8 = means('inertia of the machine', 'kg m2')
    J_c: f8 = means('inertia of the clutch', 'kg m2')
    J_e: f8 = means('inertia of the engine', 'kg m2')
    eta_pos: f8 = means('efficiency of the gearbox, driving')
    eta_neg: f8 = means('1/0.97: what the wheels deliver covers the loss')
    u_f: f8 = means('ratio of the final gear')
    m_v0: f8 = means('mass of the vehicle before fuel is consumed', 'kg')
    rho: f8 = means('density of the air', 'kg/m3')
    C_d: f8 = means('air drag')
    A_f: f8 = means('front area', 'm2')
    C_r: f8 = means('rolling resistance')
    r_w: f8 = means('radius of the wheels', 'm')
    g: f8 = means('gravity', 'm/s2')
    c_w: f8 = means('rolling resistance near standstill, the 1000 of e26', 'Nm s/rad')
    T_l0: f8 = means('loss of the gearbox', 'Nm')
    T_lg: f8 = means('likewise, of each gear below the highest', 'Nm')
    T_lw: f8 = means('likewise, with speed', 'Nm s/rad')
    n_g: f8 = means('highest gear')
    f_1_x: Annotated[f8s, 11] = means('open circuit voltage [V] over state of charge: points')
    f_1_y: Annotated[f8s, 11] = means('open circuit voltage [V] over state of charge: values')
    f_2_x: Annotated[f8s, 12] = means('inertia of the gearbox [kg m2] over gear: points')
    f_2_y: Annotated[f8s, 12] = means('inertia of the gearbox [kg m2] over gear: values')
    f_3_x: Annotated[f8s, 12] = means('ratio of the gearbox over gear: points')
    f_3_y: Annotated[f8s, 12] = means('ratio of the gearbox over gear: values')
    start_SoC: f8 = means('SoC at the start')
    start_m_f: f8 = means('m_f at the start', 'kg')
    filter_bandwidth: f8 = means('alpha of (20)', 'rad/s')


KNOWNS = ('ice_ctrl', 'u_c', 'gear', 'alpha', 'T_b_ctrl', 'I_b_sens', 'U_em_sens', 'omega_e_sens', 'omega_gb_sens')


@kernel
def reset(s: State, c: Const) -> None:
    """Let carried states begin at their start values."""
    s.SoC = c.start_SoC
    s.m_f = c.start_m_f


@kernel
def start(s: State, c: Const, u: Any) -> None:
    """Let the other states begin so that the residual does at zero."""
    s.d_SoC = 0.0
    s.d_m_f = 0.0
    omega_gb = u.omega_gb_sens  # e37
    omega_w = omega_gb/c.u_f  # e32
    s.filtered_ = 0.0  # (25)
    s.last_ = omega_w
    s.drive_ = 0.0


@kernel
def step(s: State, c: Const, u: Any, dt: float) -> float:
    """Take a sample, dt [s] behind the one before; returns the residual."""
    s.SoC += dt * s.d_SoC
    s.m_f += dt * s.d_m_f
    omega_e = u.omega_e_sens  # e36
    d_m_f = 0.25*u.ice_ctrl*omega_e/(pi*c.q_LHV)  # e1
    p_f = c.Pi_bl*c.k_1*root(c.k_4/c.B)*(c.S**2*c.k_3*omega_e**2 + c.k_2)  # e3
    T_e = 0.0625*c.B**2*c.N_cyl*c.S*(-p_f - c.p_me0_g + 4.0*c.eta_e_i*u.ice_ctrl/(pi*c.B**2*c.N_cyl*c.S))  # e2
    I_b = u.I_b_sens  # e33
    d_SoC = -I_b/c.Q_b  # e4
    U_oc = interpolate(c.f_1_x, c.f_1_y, s.SoC)  # e5
    U_b = -I_b*c.R_b + U_oc  # e6
    U_em = u.U_em_sens  # e34
    I_em = I_b*U_b/U_em  # e11
    k_a = c.eta_em_0**(sign(I_em))*c.k_i  # e9
    u_gb = interpolate(c.f_3_x, c.f_3_y, u.gear)  # e18
    omega_gb = u.omega_gb_sens  # e37
    omega_mj = omega_gb*u_gb  # e23
    omega_em = omega_mj*c.u_em  # e16
    T_em = I_em*k_a - c.c_em_f*omega_em  # e10
    T_c = T_e*u.u_c  # e12
    T_mj = T_c + T_em*c.u_em  # e14
    J_mj = c.J_c + c.J_e + c.J_em*c.u_em**2  # e15
    J_gb = interpolate(c.f_2_x, c.f_2_y, u.gear)  # e17
    T_gbl = c.T_l0 + c.T_lg*(-u.gear + c.n_g) + c.T_lw*omega_mj  # e20
    eta_gb = ((c.eta_pos) if (T_gbl < T_mj) else (c.eta_neg))  # e19
    T_gb = eta_gb*u_gb*(-T_gbl + T_mj)  # e21
    J_tot = u_gb**2*(J_gb + J_mj)  # e22
    m_v = -s.m_f + c.m_v0  # e24
    omega_w = omega_gb/c.u_f  # e32
    T_d = 0.5*c.A_f*c.C_d*omega_w**2*c.r_w**3*c.rho  # e25
    T_r = max(-c.C_r*c.g*m_v*c.r_w, min(c.c_w*omega_w, c.C_r*c.g*m_v*c.r_w))  # e26
    T_g = c.g*m_v*c.r_w*sin(u.alpha)  # e27
    T_b = u.T_b_ctrl  # e28
    T_net = -T_b - T_d - T_g + T_gb*c.u_f - T_r  # e29
    s.d_SoC = d_SoC if isfinite(d_SoC) else 0.0
    s.d_m_f = d_m_f if isfinite(d_m_f) else 0.0
    keep = exp(-c.filter_bandwidth * dt)
    b = -T_net/(J_tot*c.u_f**2 + m_v*c.r_w**2)  # e30
    r = (1.0 - keep) / dt * (omega_w - s.last_) if dt > 0.0 else c.filter_bandwidth * (omega_w - s.last_)
    r += keep * s.filtered_ + (1.0 - keep) * s.drive_  # (20)
    if isfinite(r):
        s.filtered_ = r
        s.last_ = omega_w
    if isfinite(b):
        s.drive_ = b
    else:
        r = nan
    return float(r)
