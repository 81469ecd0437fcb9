"""Tests of the vehicle's motion, while the clutch holds: T3 and T4 of ICDS and of MCDS, and T7."""

from __future__ import annotations

from gateway.fdi.structure.generator.runtime import interpolate
from gateway.jit import kernel
from gateway.monitors.truck import dynamic, excitation, gate, observer
from gateway.monitors.truck.excitation import FIXED
from gateway.monitors.truck.generated import t3_icds, t3_mcds, t4_icds, t4_mcds, t7
from gateway.monitors.truck.messages import Inputs
from gateway.monitors.truck.records import T3_FIXED, T3_MIXED, T4_FIXED, T4_MIXED, Const, State
from gateway.monitors.truck.static import take


@kernel
def _judge(s: State, c: Const, test: dynamic.State, first: int, residual: float) -> float:
    """Update the integral test quantities of T3 or T4; returns what the integrated speed is to be corrected by [rad/s].

    Args:
        s: state.
        c: constants.
        test: of ``s``, T3 or T4.
        first: place of its first test quantity.
        residual: with integral causality.
    """
    settled = dynamic.settled(test)
    for condition in range(3):
        wanted = excitation.excited(test.excitation, c.excitation, condition)
        take(s, c, first + condition, residual, settled and wanted)
    return dynamic.correction(test, residual)


@kernel
def _three(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Step T3, integral and mixed, or begin it anew."""
    step = dt
    if s.three.on == 0:
        measured, u.omega_gb_sens = u.omega_gb_sens, gate.speed(s.gate)
        t3_icds.start(s.t3, c.t3, u)
        t3_mcds.start(s.t3m, c.t3m, u)
        u.omega_gb_sens = measured
        dynamic.begin(s.three)
        step = 0.0
    s.residual[2] = t3_icds.step(s.t3, c.t3, u, step)
    s.residual[4] = t3_mcds.step(s.t3m, c.t3m, u, step)
    e = s.three.excitation
    excitation.update(e, c.excitation, s.t3.shown_I_em, s.t3.shown_u_gb, step)
    s.t3.omega_w += _judge(s, c, s.three, T3_FIXED, s.residual[2]) / c.t3.u_f
    take(s, c, T3_MIXED, s.residual[4], excitation.excited(e, c.excitation, FIXED))


@kernel
def _four(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Step T4, integral and mixed, or begin it anew."""
    step = dt
    if s.four.on == 0:
        # The battery is known all the time from T2; T4 runs for a while only.
        s.t4.SoC, s.t4m.SoC = s.t2.SoC, s.t2.SoC
        measured, u.omega_gb_sens = u.omega_gb_sens, gate.speed(s.gate)
        t4_icds.start(s.t4, c.t4, u)
        t4_mcds.start(s.t4m, c.t4m, u)
        u.omega_gb_sens = measured
        dynamic.begin(s.four)
        step = 0.0
    s.residual[3] = t4_icds.step(s.t4, c.t4, u, step)
    s.residual[5] = t4_mcds.step(s.t4m, c.t4m, u, step)
    e = s.four.excitation
    excitation.update(e, c.excitation, s.t4.shown_I_em, s.t4.shown_u_gb, step)
    s.t4.omega_w += _judge(s, c, s.four, T4_FIXED, s.residual[3]) / c.t4.u_f
    take(s, c, T4_MIXED, s.residual[5], excitation.excited(e, c.excitation, FIXED))


@kernel
def _seven(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Step T7 with its observer, or begin it anew."""
    step = dt
    if s.watched == 0:
        measured, u.omega_gb_sens = u.omega_gb_sens, gate.speed(s.gate)
        t7.start(s.t7, c.t7, u)
        u.omega_gb_sens = measured
        observer.restart(s.observer, c.observer)
        s.watched = 1
        step = 0.0
    s.residual[8] = t7.step(s.t7, c.t7, u, step)
    observer.update(s.observer, c.observer, s.t7, c.t7, s.residual[8], u.T_b_ctrl, step)


@kernel
def step(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Step the tests that need a clutch that holds."""
    ratio = interpolate(c.t2.f_3_x, c.t2.f_3_y, u.gear)
    gate.update(s.gate, u.u_c, int(u.gear), ratio, u.omega_e_sens, u.omega_gb_sens, dt)
    s.valid = 1 if gate.valid(s.gate) else 0
    if s.valid == 0:
        s.three.on, s.four.on, s.watched = 0, 0, 0
        way = dt * c.t7.r_w * u.omega_gb_sens / c.t7.u_f
        observer.age(s.observer, c.observer, dt, way if way == way else 0.0)  # noqa: PLR0124 - not NaN
        return
    _three(s, c, u, dt)
    _seven(s, c, u, dt)
    if u.U_em_sens < c.least_volts:
        s.four.on = 0
    else:
        _four(s, c, u, dt)
