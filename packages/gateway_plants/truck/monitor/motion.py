"""Tests of the vehicle's motion, while the clutch holds: T3 and T4 of ICDS and of MCDS, and T7."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from gateway_fdi.jit import kernel
from gateway_fdi.structure.generator.runtime import interpolate
from gateway_plants.truck.monitor import dynamic, excitation, gate, observer
from gateway_plants.truck.monitor.excitation import FIXED
from gateway_plants.truck.monitor.generated import t3_icds, t3_mcds, t4_icds, t4_mcds, t7
from gateway_plants.truck.monitor.messages import Inputs
from gateway_plants.truck.monitor.records import (
    R3,
    R3_MIXED,
    R4,
    R4_MIXED,
    R7,
    T3_FIXED,
    T3_MIXED,
    T4_FIXED,
    T4_MIXED,
    Const,
    State,
)
from gateway_plants.truck.monitor.static import take


class Generator(NamedTuple):
    """A residual generator: kernels and records of a generated module."""

    start: Callable[[Any, Any, Any], None]
    step: Callable[[Any, Any, Any, float], float]
    state: Any
    const: Any


class Initial(NamedTuple):
    """What the states begin with, in the place of the measured signal: its filtered value, (37), (38) [rad/s]."""

    omega_gb_sens: float


class Places(NamedTuple):
    """Where residuals and quantities of T3 or T4 are; ICDS: ``first`` is that of three conditions."""

    residual: int
    mixed_residual: int
    first: int
    mixed_test: int


_THREE = Places(R3, R3_MIXED, T3_FIXED, T3_MIXED)
_FOUR = Places(R4, R4_MIXED, T4_FIXED, T4_MIXED)


@kernel
def _residual(g: Generator, u: Inputs, begins: bool, speed: float, dt: float) -> float:
    """Step a residual generator; returns its residual.

    Args:
        g: the generator.
        u: inputs.
        begins: its states begin anew.
        speed: that they begin with [rad/s].
        dt: since the set before, 0 when they begin [s].
    """
    if begins:
        g.start(g.state, g.const, Initial(speed))
    return g.step(g.state, g.const, u, dt)


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
def _step_test(
    s: State,
    c: Const,
    u: Inputs,
    dt: float,
    test: dynamic.State,
    at: Places,
    integral: Generator,
    mixed: Generator,
) -> None:
    """Step T3 or T4, integral and mixed, or begin it anew.

    Args:
        s: state.
        c: constants.
        u: inputs.
        dt: since the set before [s].
        test: of ``s``, T3 or T4.
        at: its places.
        integral: its generator with integral causality.
        mixed: likewise, with mixed causality.
    """
    begins = test.on == 0
    speed, step = gate.speed(s.gate), 0.0 if begins else dt
    if begins:
        dynamic.begin(test)
    s.residual[at.residual] = _residual(integral, u, begins, speed, step)
    s.residual[at.mixed_residual] = _residual(mixed, u, begins, speed, step)
    g, e = integral.state, test.excitation
    excitation.update(e, c.excitation, g.shown_I_em, g.shown_u_gb, step)
    g.omega_w += _judge(s, c, test, at.first, s.residual[at.residual]) / integral.const.u_f
    take(
        s,
        c,
        at.mixed_test,
        s.residual[at.mixed_residual],
        excitation.excited(e, c.excitation, FIXED),
    )


@kernel
def _step_observer(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Step T7 with its observer, or begin it anew."""
    begins = s.watched == 0
    step = 0.0 if begins else dt
    if begins:
        observer.restart(s.observer, c.observer)
        s.watched = 1
    g = Generator(t7.start, t7.step, s.t7, c.t7)
    s.residual[R7] = _residual(g, u, begins, gate.speed(s.gate), step)
    observer.update(s.observer, c.observer, s.t7, c.t7, s.residual[R7], u.T_b_ctrl, step)


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
    three = Generator(t3_icds.start, t3_icds.step, s.t3, c.t3)
    three_mixed = Generator(t3_mcds.start, t3_mcds.step, s.t3m, c.t3m)
    _step_test(s, c, u, dt, s.three, _THREE, three, three_mixed)
    if gate.grips(s.gate, ratio, s.watched == 1):
        _step_observer(s, c, u, dt)
    else:
        s.watched = 0
        observer.age(s.observer, c.observer, dt, dt * c.t7.r_w * u.omega_gb_sens / c.t7.u_f)
    if u.U_em_sens < c.least_volts:
        s.four.on = 0
        return
    if s.four.on == 0:
        # The battery is known all the time from T2; T4 runs for a while only.
        s.t4.SoC, s.t4m.SoC = s.t2.SoC, s.t2.SoC
    four = Generator(t4_icds.start, t4_icds.step, s.t4, c.t4)
    four_mixed = Generator(t4_mcds.start, t4_mcds.step, s.t4m, c.t4m)
    _step_test(s, c, u, dt, s.four, _FOUR, four, four_mixed)
