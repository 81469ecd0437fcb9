"""Residual generator T7 of truck: made from its model, not by hand.

Consistency relation e32: omega_gb = omega_w * u_f
Sequence ({omega_e}, {e36}), ({m_f}, {e1}), ({p_f}, {e3}), ({T_e}, {e2}), ({I_em}, {e35}), ({k_a}, {e9}), ({u_gb}, {e18}), ({omega_gb}, {e37}), ({omega_mj}, {e23}), ({omega_em}, {e16}), ({T_em}, {e10}), ({T_c}, {e12}), ({T_mj}, {e14}), ({J_mj}, {e15}), ({J_gb}, {e17}), ({T_gbl}, {e20}), ({eta_gb}, {e19}), ({T_gb}, {e21}), ({J_tot}, {e22}), ({m_v}, {e24}), ({T_g}, {e27}), ({T_b}, {e28}), ({T_d, T_r, T_net, omega_w}, {e25, e26, e29, e30})
"""

from math import sin, isfinite, pi
from typing import Annotated, Any

from gateway_fdi.structure.generator.runtime import advance, interpolate, root, sign
from gateway_fdi.jit import Record, f8, f8s, kernel, means


class State(Record):
    m_f: f8 = means('fuel consumed', 'kg')
    d_m_f: f8 = means('derivative of m_f', 'kg/s')
    omega_w: f8 = means('speed of the wheels', 'rad/s')
    d_omega_w: f8 = means('derivative of omega_w', 'rad/s/s')
    jacobian_0: Annotated[f8s, 4] = means('Jacobian of m_f, omega_w')
    slopes_0: Annotated[f8s, 6] = means('slopes, changes, what is moved')
    hold_0: Annotated[f8s, 24] = means('functions of the Jacobian')
    shown_T_em: f8 = means('torque of the machine', 'Nm')
    shown_T_c: f8 = means('torque of the clutch', 'Nm')
    shown_eta_gb: f8 = means('efficiency of the gearbox')
    shown_u_gb: f8 = means('ratio of the gearbox')
    shown_J_tot: f8 = means("inertia at the gearbox's output", 'kg m2')
    shown_m_v: f8 = means('mass of the vehicle', 'kg')


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
    f_2_x: Annotated[f8s, 12] = means('inertia of the gearbox [kg m2] over gear: points')
    f_2_y: Annotated[f8s, 12] = means('inertia of the gearbox [kg m2] over gear: values')
    f_3_x: Annotated[f8s, 12] = means('ratio of the gearbox over gear: points')
    f_3_y: Annotated[f8s, 12] = means('ratio of the gearbox over gear: values')
    start_m_f: f8 = means('m_f at the start', 'kg')


@kernel
def reset(s: State, c: Const) -> None:
    """Let carried states begin at their start values."""
    s.m_f = c.start_m_f


@kernel
def start(s: State, c: Const, u: Any) -> None:
    """Let the other states begin so that the residual does at zero."""
    s.d_m_f = 0.0
    s.d_omega_w = 0.0
    omega_gb = u.omega_gb_sens  # e37
    s.omega_w = omega_gb/c.u_f


@kernel
def step(s: State, c: Const, u: Any, dt: float) -> float:
    """Take a sample, dt [s] behind the one before; returns the residual."""
    s.slopes_0[0] = s.d_m_f
    s.slopes_0[1] = s.d_omega_w
    advance(s.jacobian_0, s.slopes_0, s.hold_0, dt)
    s.m_f += s.slopes_0[4]
    s.omega_w += s.slopes_0[5]
    omega_e = u.omega_e_sens  # e36
    d_m_f = 0.25*u.ice_ctrl*omega_e/(pi*c.q_LHV)  # e1
    p_f = c.Pi_bl*c.k_1*root(c.k_4/c.B)*(c.S**2*c.k_3*omega_e**2 + c.k_2)  # e3
    T_e = 0.0625*c.B**2*c.N_cyl*c.S*(-p_f - c.p_me0_g + 4.0*c.eta_e_i*u.ice_ctrl/(pi*c.B**2*c.N_cyl*c.S))  # e2
    I_em = u.I_em_sens  # e35
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
    T_g = c.g*m_v*c.r_w*sin(u.alpha)  # e27
    T_b = u.T_b_ctrl  # e28
    T_d = 0.5*c.A_f*c.C_d*s.omega_w**2*c.r_w**3*c.rho  # e25
    T_r = max(-c.C_r*c.g*m_v*c.r_w, min(c.c_w*s.omega_w, c.C_r*c.g*m_v*c.r_w))  # e26
    T_net = -T_b - T_d - T_g + T_gb*c.u_f - T_r  # e29
    d_omega_w = T_net/(J_tot*c.u_f**2 + m_v*c.r_w**2)  # e30
    s.shown_T_em = T_em
    s.shown_T_c = T_c
    s.shown_eta_gb = eta_gb
    s.shown_u_gb = u_gb
    s.shown_J_tot = J_tot
    s.shown_m_v = m_v
    s.d_m_f = d_m_f if isfinite(d_m_f) else 0.0
    s.d_omega_w = d_omega_w if isfinite(d_omega_w) else 0.0
    m_v__m_f = -1.0
    T_g__m_f = (c.g*c.r_w*sin(u.alpha)) * m_v__m_f
    T_d__omega_w = c.A_f*c.C_d*s.omega_w*c.r_w**3*c.rho
    T_r__m_f = (c.C_r*c.g*c.r_w*((1.0) if (c.C_r*c.g*m_v*c.r_w + min(c.c_w*s.omega_w, c.C_r*c.g*m_v*c.r_w) > 0.0) else (0.0))*((1.0) if (c.C_r*c.g*m_v*c.r_w - c.c_w*s.omega_w < 0.0) else (0.0)) - c.C_r*c.g*c.r_w*((1.0) if (c.C_r*c.g*m_v*c.r_w + min(c.c_w*s.omega_w, c.C_r*c.g*m_v*c.r_w) < 0.0) else (0.0))) * m_v__m_f
    T_r__omega_w = c.c_w*((1.0) if (c.C_r*c.g*m_v*c.r_w - c.c_w*s.omega_w > 0.0) else (0.0))*((1.0) if (c.C_r*c.g*m_v*c.r_w + min(c.c_w*s.omega_w, c.C_r*c.g*m_v*c.r_w) > 0.0) else (0.0))
    T_net__m_f = (-1.0) * T_g__m_f + (-1.0) * T_r__m_f
    T_net__omega_w = (-1.0) * T_d__omega_w + (-1.0) * T_r__omega_w
    d_omega_w__m_f = (1.0 / (J_tot*c.u_f**2 + m_v*c.r_w**2)) * T_net__m_f + (-T_net*c.r_w**2/(J_tot*c.u_f**2 + m_v*c.r_w**2)**2) * m_v__m_f
    d_omega_w__omega_w = (1.0 / (J_tot*c.u_f**2 + m_v*c.r_w**2)) * T_net__omega_w
    s.jacobian_0[2] = d_omega_w__m_f if isfinite(d_omega_w__m_f) else 0.0
    s.jacobian_0[3] = d_omega_w__omega_w if isfinite(d_omega_w__omega_w) else 0.0
    r = omega_gb - s.omega_w*c.u_f  # e32
    return float(r)
