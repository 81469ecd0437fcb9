"""A synchronous motor under field oriented control, closed through sensors that may be faulty.

Plant: (17), (18) of paper 001 with L_d = L_q and the torque of its power balance, in stator co-ordinates, second order
Runge-Kutta. Controller at 10 kHz: position, speed and current loops, Park with the measured angle; what a sensor
reads wrong, the motor does. It tells what an ECU's bus messages carry: currents at the end of each frame, mean
voltages in the controller's frame, the angle that was used for Park.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import cos, pi, sin, tanh
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.fdi.filters import motor
from gateway.fdi.filters.motor import Motor
from gateway.fdi.filters.transforms import clarke, inverse_clarke, inverse_park, park
from gateway.jit import f8, kernel, record, zeros

#: Controller's period [s], and integration steps in it.
CONTROL, SUBSTEPS = 1e-4, 5
#: Bandwidths: current loop, speed loop and its integral, estimator of the measured speed [rad/s]; position gain [1/s].
CURRENT_LOOP, SPEED_LOOP, SPEED_INTEGRAL, TRACKER, POSITION = 1900.0, 190.0, 40.0, 500.0, 25.0
#: Speed below which Coulomb friction fades [rad/s], and current below which the dead time's voltage does [A].
CREEP, ZERO_CURRENT = 0.05, 0.3

CONST = record(
    motor=motor.Const,
    believed=motor.Const,
    coulomb=f8,
    dead=f8,
    voltage=f8,
    current=f8,
    lsb=f8,
    current_lsb=f8,
)

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
def _dead(c: Any, i_alpha: float, i_beta: float) -> tuple[float, float]:
    """Return the voltage that dead time takes, alpha and beta."""
    i_u, i_v = inverse_clarke(i_alpha, i_beta)
    d_u = c.dead * tanh(i_u / ZERO_CURRENT)
    d_v = c.dead * tanh(i_v / ZERO_CURRENT)
    d_w = -c.dead * tanh((i_u + i_v) / ZERO_CURRENT)
    zero = (d_u + d_v + d_w) / 3.0
    return clarke(d_u - zero, d_v - zero)


@kernel
def _slope(c: Any, x: Any, d: Any, u_alpha: float, u_beta: float, load: float) -> None:
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
def simulate(
    c: Any, demand: Any, load: Any, wrong: Any, noise: Any, out: Any, voltage_noise: Any, per: int,
    scratch: Any,
) -> None:  # fmt: skip
    """Run the drive.

    Args:
        c: record of CONST.
        demand: angle asked for, shape (n,) [rad].
        load: torque that pushes against the motor, shape (n,) [N m].
        wrong: shape (n,) of DISTURBANCE.
        noise: shape (n, 3), of the angle [rad] and the two currents [A].
        out: shape (n // per,) of SAMPLE.
        voltage_noise: shape (n // per, 2) [V].
        per: controller samples a frame.
        scratch: zeros, shape (4, 4).
    """
    m, b = c.motor, c.believed
    x, k1, mid, k2 = scratch[0], scratch[1], scratch[2], scratch[3]
    x[3] = demand[0]
    h = CONTROL / SUBSTEPS
    emf = b.flux * b.pole_pairs
    speed_gain = b.inertia * SPEED_LOOP / (1.5 * emf)
    seen, speed, wound = demand[0], 0.0, 0.0
    held_d, held_q = 0.0, 0.0
    last_angle, last_current = demand[0], 0.0
    mean_d = mean_q = mean_a = mean_b = 0.0
    at = 0
    for k in range(demand.shape[0]):
        e = wrong[k]
        angle = _rounded(e.scale * x[3] + e.angle + noise[k, 0], c.lsb)
        if e.stuck > 0.0:
            angle = last_angle
        last_angle = angle
        i_u, i_v = inverse_clarke(x[0], x[1])
        i_u = _rounded(e.gain * i_u + e.current + noise[k, 1], c.current_lsb)
        if e.frozen > 0.0:
            i_u = last_current
        last_current = i_u
        i_v = _rounded(i_v + noise[k, 2], c.current_lsb)
        i_alpha, i_beta = clarke(i_u, i_v)
        electrical = b.pole_pairs * angle
        i_d, i_q = park(i_alpha, i_beta, electrical)
        if k > 0 and k % per == 0:
            s = out[at]
            s.i_u, s.i_v = i_u, i_v
            s.u_d = mean_d / per + voltage_noise[at, 0]
            s.u_q = mean_q / per + voltage_noise[at, 1]
            s.u_alpha = mean_a / per + voltage_noise[at, 0]
            s.u_beta = mean_b / per + voltage_noise[at, 1]
            s.sensor = angle
            s.theta, s.omega = x[3], x[2]
            s.i_d, s.i_q = park(x[0], x[1], m.pole_pairs * x[3])
            at += 1
            mean_d = mean_q = mean_a = mean_b = 0.0
        # Measured speed: a tracking loop on the measured angle.
        error = angle - seen
        speed += TRACKER * TRACKER * error * CONTROL
        seen += (speed + 2.0 * TRACKER * error) * CONTROL
        asked = 0.0
        if k > 0:
            asked = (demand[k] - demand[k - 1]) / CONTROL
        lag = asked + POSITION * (demand[k] - angle) - speed
        wanted = speed_gain * (lag + wound)
        if abs(wanted) < c.current:
            wound += SPEED_INTEGRAL * lag * CONTROL
        wanted = min(max(wanted, -c.current), c.current)
        # Current loops with decoupling.
        held_d += CURRENT_LOOP * b.resistance * -i_d * CONTROL
        held_q += CURRENT_LOOP * b.resistance * (wanted - i_q) * CONTROL
        turning = b.pole_pairs * speed
        u_d = -CURRENT_LOOP * b.ld * i_d + held_d - turning * b.lq * i_q
        u_q = CURRENT_LOOP * b.lq * (wanted - i_q) + held_q + turning * (b.ld * i_d + b.flux)
        size = np.sqrt(u_d * u_d + u_q * u_q)
        if size > c.voltage:
            u_d, u_q = u_d * c.voltage / size, u_q * c.voltage / size
            held_d *= 0.99
            held_q = min(max(held_q, -c.voltage), c.voltage)
        u_alpha, u_beta = inverse_park(u_d, u_q, electrical + 0.5 * turning * CONTROL)
        mean_d, mean_q = mean_d + u_d, mean_q + u_q
        mean_a, mean_b = mean_a + u_alpha, mean_b + u_beta
        # A voltage that is added to U alone is two thirds of it in alpha: the neutral floats.
        u_alpha = e.supply * u_alpha + 2.0 / 3.0 * e.volts
        u_beta = e.supply * u_beta
        for _ in range(SUBSTEPS):
            d_alpha, d_beta = _dead(c, x[0], x[1])
            _slope(c, x, k1, u_alpha - d_alpha, u_beta - d_beta, load[k])
            for j in range(4):
                mid[j] = x[j] + 0.5 * h * k1[j]
            _slope(c, mid, k2, u_alpha - d_alpha, u_beta - d_beta, load[k])
            for j in range(4):
                x[j] += h * k2[j]


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
    c = zeros(1, CONST)
    motor.prepare(c[0]["motor"], plant.motor)
    motor.prepare(c[0]["believed"], plant.believed)
    for name in ("coulomb", "dead", "voltage", "current"):
        c[0][name] = getattr(plant, name)
    c[0]["lsb"] = 2 * pi / (1 << plant.angle_bits) if plant.angle_bits else 0.0
    c[0]["current_lsb"] = 200.0 / (1 << plant.current_bits) if plant.current_bits else 0.0
    noise = rng.normal(size=(n, 3)) * [plant.angle_noise, plant.current_noise, plant.current_noise]
    frames = (n - 1) // per
    out = np.zeros(frames, SAMPLE)
    voltage_noise = rng.normal(size=(frames, 2)) * plant.voltage_noise
    simulate(
        c.view(np.recarray)[0],
        demand,
        load,
        wrong.view(np.recarray),
        noise,
        out.view(np.recarray),
        voltage_noise,
        per,
        np.zeros((4, 4)),
    )
    return out
