"""A synchronous motor under field oriented control, closed through sensors that may be faulty.

Plant: (17), (18) of paper 001 with L_d = L_q and the torque of its power balance, in stator co-ordinates, second order
Runge-Kutta. Controller (:mod:`gateway_plants.steering.ecu.controller`): Park with the measured angle, so what a sensor
reads wrong, the motor does. It tells what an ECU's bus messages carry: currents at the end of each frame, mean voltages
in the controller's frame, the angle that was used for Park.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import cos, pi, sin, tanh
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.filters import motor
from gateway_fdi.filters.motor import Motor
from gateway_fdi.filters.transforms import clarke, inverse_clarke, inverse_park, park
from gateway_fdi.jit import Record, f8, f8s, kernel, means, record, zeros
from gateway_plants.steering.ecu import controller
from gateway_plants.steering.ecu.controller import CONTROL, advanced, control

#: Integration steps in a period of the controller.
SUBSTEPS = 5
#: Speed below which Coulomb friction fades [rad/s], and current below which the dead time's voltage does [A].
CREEP, ZERO_CURRENT = 0.05, 0.3


class Const(Record):
    """The drive, for kernels."""

    motor: motor.Const = means("the motor as it is")
    controller: controller.Const = means("what the controller knows")
    coulomb: f8 = means("friction", "N m")
    dead: f8 = means("voltage lost to dead time in a phase", "V")
    lsb: f8 = means("step of the angle sensor, 0: not digitised", "rad")
    current_lsb: f8 = means("step of the current sensors, 0: not digitised", "A")


class State(Record):
    """State of the drive."""

    x: Annotated[f8s, 4] = means("i_alpha, i_beta [A], omega [rad/s], theta [rad]")
    slope: Annotated[f8s, 4] = means("derivative of x, in a step of integration")
    middle: Annotated[f8s, 4] = means("x in the middle of that step")
    controller: controller.State = means("the controller's state")
    angle: f8 = means("last reading of the angle", "rad")
    current: f8 = means("last reading of the current of U", "A")
    sum_d: f8 = means("sum of voltages since the last frame, d", "V")
    sum_q: f8 = means("sum of voltages since the last frame, q", "V")
    sum_alpha: f8 = means("sum of voltages since the last frame, alpha", "V")
    sum_beta: f8 = means("sum of voltages since the last frame, beta", "V")


#: What may go wrong, sample by sample of the controller: added to the angle [rad], its scale, the angle stands still;
#: added to the current of U [A], its scale, it stands still; scale of all voltages, added to the voltage of U [V].
DISTURBANCE = record(
    angle=f8,
    scale=f8,
    stuck=f8,
    current=f8,
    gain=f8,
    frozen=f8,
    supply=f8,
    volts=f8,
)

#: One bus frame: currents [A], mean voltages [V] in the controller's frame and in the stator's, mechanical sensor angle
#: [rad] and its Park angle, and the truth.
SAMPLE = record(
    i_u=f8,
    i_v=f8,
    u_d=f8,
    u_q=f8,
    u_alpha=f8,
    u_beta=f8,
    sensor=f8,
    theta=f8,
    omega=f8,
    i_d=f8,
    i_q=f8,
)


@dataclass(frozen=True)
class Plant:
    """A motor with its drive.

    Attributes:
        motor: as it is.
        believed: as the controller believes it to be.
        coulomb: friction [N m].
        dead: voltage lost to dead time in a phase [V].
        voltage: largest voltage [V].
        current: largest current asked for [A].
        angle_noise: standard deviation of a sample [rad].
        angle_bits: of the angle sensor over a turn; 0: not digitised.
        current_noise: standard deviation [A].
        current_bits: of the current sensors over 200 A; 0: not digitised.
        voltage_noise: standard deviation of a mean as it is sent [V].
    """

    motor: Motor = field(default_factory=Motor)
    believed: Motor = field(default_factory=Motor)
    coulomb: float = 0.02
    dead: float = 0.0
    voltage: float = 6.5
    current: float = 50.0
    angle_noise: float = 1.5e-3
    angle_bits: int = 12
    current_noise: float = 0.2
    current_bits: int = 12
    voltage_noise: float = 0.03


def undisturbed(n: int) -> NDArray[np.void]:
    """Return disturbances, shape (n,) of DISTURBANCE, that change nothing."""
    d = np.zeros(n, DISTURBANCE)
    d["scale"] = d["gain"] = d["supply"] = 1.0
    return d


@kernel
def _rounded(value: float, lsb: float) -> float:
    return float(np.rint(value / lsb) * lsb) if lsb > 0.0 else value


@kernel
def _dead(c: Const, i_alpha: float, i_beta: float) -> tuple[float, float]:
    """Return the voltage that dead time takes, alpha and beta."""
    i_u, i_v = inverse_clarke(i_alpha, i_beta)
    d_u = c.dead * tanh(i_u / ZERO_CURRENT)
    d_v = c.dead * tanh(i_v / ZERO_CURRENT)
    d_w = -c.dead * tanh((i_u + i_v) / ZERO_CURRENT)
    zero = (d_u + d_v + d_w) / 3.0
    return clarke(d_u - zero, d_v - zero)


@kernel
def _slope(c: Const, x: f8s, d: f8s, u_alpha: float, u_beta: float, load: float) -> None:
    """Derivative of (i_alpha, i_beta, omega, theta)."""
    m = c.motor
    cosine, sine = cos(m.pole_pairs * x[3]), sin(m.pole_pairs * x[3])
    flux = m.flux * m.pole_pairs
    d[0] = (u_alpha - m.resistance * x[0] + flux * x[2] * sine) / m.ld
    d[1] = (u_beta - m.resistance * x[1] - flux * x[2] * cosine) / m.ld
    pulled = 1.5 * flux * (x[1] * cosine - x[0] * sine)
    slowed = m.friction * x[2] + c.coulomb * tanh(x[2] / CREEP) + load
    d[2] = (pulled - slowed) / m.inertia
    d[3] = x[2]


@kernel
def _integrate(c: Const, s: State, u_alpha: float, u_beta: float, load: float) -> None:
    """Integrate the motor over a period of the controller, under the inverter's voltages [V] and a load [N m]."""
    x, slope, middle = s.x, s.slope, s.middle
    h = CONTROL / SUBSTEPS
    for _ in range(SUBSTEPS):
        d_alpha, d_beta = _dead(c, x[0], x[1])
        _slope(c, x, slope, u_alpha - d_alpha, u_beta - d_beta, load)
        for j in range(4):
            middle[j] = x[j] + 0.5 * h * slope[j]
        _slope(c, middle, slope, u_alpha - d_alpha, u_beta - d_beta, load)
        for j in range(4):
            x[j] += h * slope[j]


@kernel
def _read_angle(c: Const, s: State, wrong: Any, noise: float) -> float:
    """Return what the angle sensor reads [rad], with what is wrong and with noise."""
    angle = _rounded(wrong.scale * s.x[3] + wrong.angle + noise, c.lsb)
    if wrong.stuck > 0.0:
        angle = s.angle
    s.angle = angle
    return float(angle)


@kernel
def _read_currents(c: Const, s: State, wrong: Any, noise_u: float, noise_v: float) -> tuple[float, float]:
    """Return what the current sensors of U and V read [A], with what is wrong and with noise."""
    i_u, i_v = inverse_clarke(s.x[0], s.x[1])
    i_u = _rounded(wrong.gain * i_u + wrong.current + noise_u, c.current_lsb)
    if wrong.frozen > 0.0:
        i_u = s.current
    s.current = i_u
    return i_u, _rounded(i_v + noise_v, c.current_lsb)


@kernel
def _write_frame(c: Const, s: State, i_u: float, i_v: float, noise: Any, per: int, out: Any) -> None:
    """Write a frame and begin the next.

    Args:
        i_u: measured [A].
        i_v: measured [A].
        noise: of the mean voltages, shape (2,) [V].
        per: controller samples a frame.
        out: record of SAMPLE.
    """
    out.i_u, out.i_v = i_u, i_v
    out.u_d = s.sum_d / per + noise[0]
    out.u_q = s.sum_q / per + noise[1]
    out.u_alpha = s.sum_alpha / per + noise[0]
    out.u_beta = s.sum_beta / per + noise[1]
    out.sensor = s.angle
    out.theta, out.omega = s.x[3], s.x[2]
    out.i_d, out.i_q = park(s.x[0], s.x[1], c.motor.pole_pairs * s.x[3])
    s.sum_d = s.sum_q = s.sum_alpha = s.sum_beta = 0.0


@kernel
def simulate(
    c: Const, s: State, demand: f8s, load: f8s, wrong: Any, noise: f8s, voltage_noise: f8s, per: int, out: Any
) -> None:  # fmt: skip
    """Run the drive.

    Args:
        s: state, zeros.
        demand: angle asked for, shape (n,) [rad].
        load: torque that pushes against the motor, shape (n,) [N m].
        wrong: shape (n,) of DISTURBANCE.
        noise: shape (n, 3), of the angle [rad] and the two currents [A].
        voltage_noise: shape (n // per, 2) [V].
        per: controller samples a frame.
        out: shape (n // per,) of SAMPLE.
    """
    s.x[3] = s.angle = s.controller.seen = demand[0]
    at = 0
    for k in range(demand.shape[0]):
        e = wrong[k]
        angle = _read_angle(c, s, e, noise[k, 0])
        i_u, i_v = _read_currents(c, s, e, noise[k, 1], noise[k, 2])
        i_alpha, i_beta = clarke(i_u, i_v)
        i_d, i_q = park(i_alpha, i_beta, c.controller.believed.pole_pairs * angle)
        if k > 0 and k % per == 0:
            _write_frame(c, s, i_u, i_v, voltage_noise[at], per, out[at])
            at += 1
        asked = (demand[k] - demand[k - 1]) / CONTROL if k > 0 else 0.0
        u_d, u_q = control(c.controller, s.controller, demand[k], asked, angle, i_d, i_q)
        u_alpha, u_beta = inverse_park(u_d, u_q, advanced(c.controller, s.controller, angle))
        s.sum_d, s.sum_q = s.sum_d + u_d, s.sum_q + u_q
        s.sum_alpha, s.sum_beta = s.sum_alpha + u_alpha, s.sum_beta + u_beta
        # A voltage that is added to U alone is two thirds of it in alpha: the neutral floats.
        u_alpha = e.supply * u_alpha + 2.0 / 3.0 * e.volts
        u_beta = e.supply * u_beta
        _integrate(c, s, u_alpha, u_beta, load[k])


def _constants(plant: Plant) -> Any:
    """Return a record of Const."""
    c = zeros(1, Const)[0]
    motor.prepare(c.motor, plant.motor)
    motor.prepare(c.controller.believed, plant.believed)
    c.controller.voltage, c.controller.current = plant.voltage, plant.current
    c.coulomb, c.dead = plant.coulomb, plant.dead
    c.lsb = 2 * pi / (1 << plant.angle_bits) if plant.angle_bits else 0.0
    c.current_lsb = 200.0 / (1 << plant.current_bits) if plant.current_bits else 0.0
    return c


def drive(
    plant: Plant,
    demand: NDArray[np.float64],
    load: NDArray[np.float64],
    wrong: NDArray[np.void],
    rng: np.random.Generator,
    period: float = 1e-3,
) -> NDArray[np.void]:
    """Run a drive; returns a frame for each period, shape (m,) of SAMPLE, the first at ``period``.

    Args:
        plant: the motor and its drive.
        demand: angle at each controller sample, shape (n,) [rad].
        load: torque at each [N m].
        wrong: shape (n,) of DISTURBANCE.
        rng: source of all noise.
        period: of the frames, a multiple of the controller's [s].
    """
    n, per = len(demand), round(period / CONTROL)
    noise = rng.normal(size=(n, 3)) * [plant.angle_noise, plant.current_noise, plant.current_noise]
    frames = (n - 1) // per
    out = np.zeros(frames, SAMPLE)
    voltage_noise = rng.normal(size=(frames, 2)) * plant.voltage_noise
    simulate(
        _constants(plant), zeros(1, State)[0], demand, load, wrong.view(np.recarray), noise,
        voltage_noise, per, out.view(np.recarray),
    )  # fmt: skip
    return out
