"""T7, the test of the vehicle's motion, while the clutch holds."""

from __future__ import annotations

from typing import NamedTuple

from gateway_fdi.jit import kernel
from gateway_fdi.structure.generator.runtime import interpolate
from gateway_plants.truck.monitor import gate, observer
from gateway_plants.truck.monitor.generated import t7
from gateway_plants.truck.monitor.messages import Inputs
from gateway_plants.truck.monitor.records import R7, Const, State


class Initial(NamedTuple):
    """What the states begin with, in the place of the measured signal: its filtered value, (37), (38) [rad/s]."""

    omega_gb_sens: float


@kernel
def _step_observer(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Step T7 with its observer, or begin it again."""
    step = dt
    if s.watched == 0:
        observer.restart(s.observer, c.observer)
        t7.start(s.t7, c.t7, Initial(gate.speed(s.gate)))
        s.watched, step = 1, 0.0
    s.residual[R7] = t7.step(s.t7, c.t7, u, step)
    observer.update(s.observer, c.observer, s.t7, c.t7, s.residual[R7], u.T_b_ctrl, step)


@kernel
def watch(s: State, c: Const, u: Inputs, dt: float) -> float:
    """Watch whether the model of the motion holds (``valid``); returns the ratio of the gear."""
    ratio = interpolate(c.t2.f_3_x, c.t2.f_3_y, u.gear)
    gate.update(s.gate, u.u_c, int(u.gear), ratio, u.omega_e_sens, u.omega_gb_sens, dt)
    s.valid = 1 if gate.valid(s.gate) else 0
    return float(ratio)


@kernel
def step(s: State, c: Const, u: Inputs, dt: float) -> None:
    """Step the test that needs a clutch that holds."""
    ratio = watch(s, c, u, dt)
    if s.valid == 1 and gate.grips(s.gate, ratio, s.watched == 1):
        _step_observer(s, c, u, dt)
        return
    s.watched = 0
    way = dt * c.t7.r_w * u.omega_gb_sens / c.t7.u_f
    observer.age(s.observer, c.observer, dt, way if way == way else 0.0)  # noqa: PLR0124 - not NaN
