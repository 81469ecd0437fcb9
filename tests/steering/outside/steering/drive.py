"""The drive: motor in dq by Runge-Kutta each 50 us, field-oriented control at 10 kHz, sensors in the loop."""

from dataclasses import dataclass, replace

import numba
import numpy as np
from scipy.signal import butter, sosfiltfilt

#: Step of the machine and of the controller [s].
STEP, CONTROL = 50e-6, 100e-6
#: Columns of what is sampled each millisecond.
COLUMNS = ("sensor", "true", "i_u", "i_v", "u_d", "u_q", "i_d", "omega", "wheel", "rate")


@dataclass(frozen=True)
class Machine:
    """The real one; what the monitor is told stands in `told`."""

    pole_pairs: int = 5
    flux: float = 6.2e-3
    resistance: float = 0.048
    ld: float = 1.2e-4
    lq: float = 1.2e-4
    inertia: float = 1.6e-4
    friction: float = 8e-4
    coulomb: float = 0.02
    dead: float = 0.04
    ratio: float = 24.0
    steps: int = 16384  # of the angle sensor in a turn
    noise: float = 3e-4  # of it [rad]
    current_noise: float = 0.05

    def changed(self, **values):
        return replace(self, **values)


def told(machine, **more):
    """Parameters of the monitor for a machine that is as it is told."""
    motor = {
        "pole_pairs": machine.pole_pairs, "flux": machine.flux, "resistance": machine.resistance,
        "inductance": machine.lq, "inertia": machine.inertia, "friction": machine.friction,
    }  # fmt: skip
    return {"type": "steering_angle", "motor": motor, "motor_ratio": machine.ratio, **more}


def wheel_course(seconds, rng):
    """Steering wheel angle [deg] each control step: rests, corners, quick swerves, low-passed as an arm is."""
    n = round(seconds / CONTROL)
    t = np.arange(n) * CONTROL
    ends = np.cumsum(rng.uniform(0.6, 2.5, int(seconds / 0.6) + 4))
    levels = np.where(rng.random(len(ends)) < 0.35, 0.0, rng.normal(0, 35.0, len(ends)))
    steps = levels[np.searchsorted(ends, t)]
    slow = sosfiltfilt(butter(2, 1.1, fs=1 / CONTROL, output="sos"), steps)
    return slow * np.clip((t - 1.0) / 0.5, 0, 1)


@numba.njit(cache=False)
def _machine(x, u_d, u_q, load, p):
    z, psi, r, ld, lq, j, b = p[0], p[1], p[2], p[3], p[4], p[5], p[6]
    i_d, i_q, w = x[0], x[1], x[2]
    torque = 1.5 * z * (psi * i_q + (ld - lq) * i_d * i_q)
    return np.array(
        [(u_d - r * i_d + z * w * lq * i_q) / ld, (u_q - r * i_q - z * w * (ld * i_d + psi)) / lq,
         (torque - b * w - load) / j, w]
    )  # fmt: skip


@numba.njit(cache=False)
def _run(p, wheel, noise, add, held, gain, current_noise):
    """Run; ``add``, ``gain`` of the sensor each ms, ``held``: first ms from which it repeats its reading."""
    z, ld, lq, psi = p[0], p[3], p[4], p[1]
    coulomb, dead, ratio, code, weak = p[7], p[8], p[9], p[10], p[11]
    n = len(wheel) // 10
    out = np.zeros((n, 10))
    x = np.zeros(4)
    wound_d, wound_q, wound_w = 0.0, 0.0, 0.0
    before, speed = 0.0, 0.0
    kept, u_d_sum, u_q_sum = 0.0, 0.0, 0.0
    volts = 6.5
    for k in range(n * 10):
        ms = k // 10
        reading = np.rint((x[3] * gain[ms] + add[ms] + noise[k]) / code) * code
        if ms >= held:
            reading = kept
        kept = reading
        speed += 0.08 * ((reading - before) / 1e-4 - speed)
        before = reading
        last = wheel[k - 1] if k else 0.0
        rate = (wheel[k] - last) / 1e-4
        # Active steering adds a share of the driver's angle.
        wanted = 0.35 * wheel[k] * np.pi / 180.0 * ratio
        off = min(max(60.0 * (wanted - reading), -120.0), 120.0) + 0.35 * rate * np.pi / 180.0 * ratio - speed
        wound_w = min(max(wound_w + 4.0 * off * 1e-4, -30.0), 30.0)
        i_ref = min(max(0.12 * off + wound_w, -35.0), 35.0)
        # Currents as the controller sees them: Park by the sensor's angle.
        error = z * (reading - x[3])
        c, s = np.cos(error), np.sin(error)
        i_d, i_q = c * x[0] + s * x[1], c * x[1] - s * x[0]
        e_d, e_q = weak - i_d, i_ref - i_q
        wound_d += 60.0 * e_d * 1e-4
        wound_q += 60.0 * e_q * 1e-4
        u_d = 0.12 * e_d + wound_d - z * speed * lq * i_q
        u_q = 0.12 * e_q + wound_q + z * speed * (ld * i_d + psi)
        size = np.hypot(u_d, u_q)
        if size > volts:
            u_d, u_q = u_d * volts / size, u_q * volts / size
            wound_d -= 60.0 * e_d * 1e-4
            wound_q -= 60.0 * e_q * 1e-4
        u_d_sum += u_d
        u_q_sum += u_q
        # Inverter: the controller's frame stands for the rotor's, but for the error; dead time acts along the current.
        size = max(np.hypot(i_d, i_q), 0.5)
        v_d, v_q = u_d - dead * i_d / size, u_q - dead * i_q / size
        v_d, v_q = c * v_d - s * v_q, s * v_d + c * v_q
        for _ in range(2):
            rubbing = coulomb * np.tanh(x[2] / 2.0)
            load = 0.004 * x[3] + rubbing
            h = 50e-6
            k1 = _machine(x, v_d, v_q, load, p)
            k2 = _machine(x + 0.5 * h * k1, v_d, v_q, load, p)
            k3 = _machine(x + 0.5 * h * k2, v_d, v_q, load, p)
            k4 = _machine(x + h * k3, v_d, v_q, load, p)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        if k % 10 == 9:
            reading = np.rint((x[3] * gain[ms] + add[ms] + noise[k]) / code) * code if ms < held else kept
            theta = z * x[3]
            i_a = x[0] * np.cos(theta) - x[1] * np.sin(theta)
            i_b = x[0] * np.sin(theta) + x[1] * np.cos(theta)
            row = out[ms]
            row[0], row[1] = reading, x[3]
            row[2], row[3] = i_a + current_noise[ms, 0], -0.5 * i_a + 0.8660254037844386 * i_b + current_noise[ms, 1]
            row[4], row[5] = u_d_sum / 10.0, u_q_sum / 10.0
            row[6], row[7] = x[0], x[2]
            row[8], row[9] = wheel[k], rate
            u_d_sum, u_q_sum = 0.0, 0.0
    return out


def drive(machine, seconds, rng, *, add=None, gain=None, held=None, weak=0.0):
    """Sample a drive each millisecond: name -> shape (n,).

    Args:
        machine: the real one.
        seconds: length.
        rng: of all that is random.
        add: error of the angle sensor each ms [rad].
        gain: of it.
        held: second from which it repeats its reading.
        weak: current along d that the controller asks for [A].
    """
    n = round(seconds * 1e3)
    p = np.array(
        [machine.pole_pairs, machine.flux, machine.resistance, machine.ld, machine.lq, machine.inertia,
         machine.friction, machine.coulomb, machine.dead, machine.ratio, 2 * np.pi / machine.steps, weak]
    )  # fmt: skip
    wheel = wheel_course(seconds, rng)
    out = _run(
        p, wheel, rng.normal(0, machine.noise, len(wheel)), np.zeros(n) if add is None else add,
        n + 1 if held is None else round(held * 1e3), np.ones(n) if gain is None else gain,
        rng.normal(0, machine.current_noise, (n, 2)),
    )  # fmt: skip
    return {name: out[:, k] for k, name in enumerate(COLUMNS)}
