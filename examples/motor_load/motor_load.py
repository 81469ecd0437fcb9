"""Load of a DC motor, by an observer: speed and current are measured, the load torque is not.

    J dw/dt = k i - d w - T        T is constant but for noise
    x = (w, T),   x(n+1) = Phi x(n) + Gamma i(n) + L e(n),   e(n) = w_measured - w

The gain L is Kalman's, stationary: designed by SciPy once, before the first step. The kernel has the two equations.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt

import numpy as np
from pydantic import Field
from scipy.linalg import expm, solve_discrete_are

from gateway.monitors import contract
from gateway.monitors.contract import (
    TIMER,
    Connection,
    Debounce,
    Emission,
    Fault,
    Monitor,
    MonitorParams,
    Out,
    Readout,
    Signal,
    report,
)
from gateway_fdi.jit import Record, f8, kernel, labels, means

#: Samples until the observer has settled, and until a verdict is taken for sure.
SETTLES, SURE = 50, 20


class Params(MonitorParams):
    """Keys of the table ``[[monitor]]``."""

    inertia: float = Field(2e-4, gt=0, description="J [kg m2]")
    constant: float = Field(0.05, gt=0, description="k [N m/A]")
    friction: float = Field(1e-4, ge=0, description="d [N m s/rad]")
    sample_ms: float = Field(10.0, gt=0, description="between two samples [ms]")
    speed_noise: float = Field(1.0, gt=0, description="of the sensor, standard deviation [rad/s]")
    load_drift: float = Field(0.05, gt=0, description="of the load, in the root of a second [N m]")
    most_load: float = Field(0.3, gt=0, description="more is a jam [N m]")
    gate: float = Field(5.0, gt=0, description="of the innovation, in standard deviations")


class State(Record):
    """What a step leaves for the next."""

    speed: f8 = means(unit="rad/s")
    load: f8 = means(unit="N m")
    samples: f8 = means("samples so far")


class Const(Record):
    """What stays: Phi, Gamma, L, and the limits."""

    phi_ww: f8 = means("speed by the speed before")
    phi_wt: f8 = means("speed by the load", "rad/s/(N m)")
    gamma: f8 = means("speed by the current", "rad/s/A")
    gain_w: f8 = means("speed by the innovation")
    gain_t: f8 = means("load by the innovation", "N m/(rad/s)")
    spread: f8 = means("of the innovation", "rad/s")
    gate: f8 = means("of the innovation, in standard deviations")
    most_load: f8 = means("more is a jam", "N m")


class Inputs(contract.Inputs):
    """What a step gets."""

    speed: f8 = means(unit="rad/s")
    current: f8 = means(unit="A")


class Evidence(Record):
    """What is kept with a result."""

    innovation: f8 = means(unit="rad/s")
    load: f8 = means(unit="N m")
    current: f8 = means(unit="A")


class Outputs(Record):
    """What it sends."""

    load: f8 = means(unit="N m")
    speed: f8 = means(unit="rad/s")


SENSOR, JAM = range(2)


def faults(_: Params) -> tuple[Fault, ...]:
    """Return what it can report, in the order of the numbers above."""
    sure = Debounce(failed_after=SURE, passed_after=SURE)
    return (
        Fault(
            "speed",
            "C1B40-64",
            "speed sensor contradicts the current",
            labels(Evidence),
            sure,
            tested="innovation [rad/s]",
        ),
        Fault("jam", "C1B41-72", "load is more than the drive can have", labels(Evidence), sure, tested="load [N m]"),
    )


def connect(_: Params) -> Mapping[str, Connection]:
    """Return what each input is connected to."""
    return {
        "speed": Signal("MOTOR.Speed", unit="rad/s", triggers=True),
        "current": Signal("MOTOR.Current", unit="A"),
    }


def emits(_: Params) -> Emission:
    """Return the message that it sends, where the configuration says ``send = true``."""
    return Emission("MOTOR_LOAD", {"load": "Load", "speed": "Speed"})


def prepare(p: Params, s: State, c: Const) -> None:
    """Bring the plant to discrete time, and design the observer."""
    period = 1e-3 * p.sample_ms
    a = np.array([[-p.friction / p.inertia, -1.0 / p.inertia], [0.0, 0.0]])
    b = np.array([[p.constant / p.inertia], [0.0]])
    whole = expm(period * np.block([[a, b], [np.zeros((1, 3))]]))
    phi, gamma = whole[:2, :2], whole[:2, 2]
    q = np.diag([1e-6, p.load_drift**2 * period])
    r = np.array([[p.speed_noise**2]])
    h = np.array([[1.0, 0.0]])
    spread = solve_discrete_are(phi.T, h.T, q, r)
    variance = h @ spread @ h.T + r
    gain = phi @ spread @ h.T / variance
    c.phi_ww, c.phi_wt, c.gamma = phi[0, 0], phi[0, 1], gamma[0]
    c.gain_w, c.gain_t = gain[0, 0], gain[1, 0]
    c.spread, c.gate, c.most_load = sqrt(variance[0, 0]), p.gate, p.most_load


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Outputs]) -> None:
    """Take one sample."""
    if u.trigger == TIMER:
        return
    if s.samples == 0.0:
        s.speed = u.speed
    innovation = u.speed - s.speed
    s.samples += 1.0
    if s.samples > SETTLES:
        limit = c.gate * c.spread
        e = report(out, SENSOR, abs(innovation) > limit, innovation, limit)
        e.innovation, e.load, e.current = innovation, s.load, u.current
        e = report(out, JAM, abs(s.load) > c.most_load, s.load, c.most_load)
        e.innovation, e.load, e.current = innovation, s.load, u.current
    out.values.load, out.values.speed = s.load, s.speed
    out.send = 1
    speed = c.phi_ww * s.speed + c.phi_wt * s.load + c.gamma * u.current + c.gain_w * innovation
    s.load += c.gain_t * innovation
    s.speed = speed


MONITOR = Monitor(
    type="motor_load",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    evidence=Evidence,
    outputs=Outputs,
    step=step,
    connect=connect,
    prepare=prepare,
    faults=faults,
    emits=emits,
    capabilities=(Readout(("speed", "load")),),
)
