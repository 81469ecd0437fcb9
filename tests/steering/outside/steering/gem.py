"""A drive that nobody here wrote: machine, inverter and solver of gym-electric-motor, with a load."""

import warnings
from functools import cache

import numpy as np

from steering.drive import Machine

TAU, SECONDS = 1e-4, 3.0
#: Parameters of the machine.
GEM = Machine(
    pole_pairs=6, flux=5.5e-3, resistance=0.055, ld=1.1e-4, lq=1.1e-4, inertia=2e-4, friction=6e-4, ratio=22.0
)


def _system(m):
    from gym_electric_motor import physical_systems as physical
    from gym_electric_motor.physical_systems import solvers

    limits = {"omega": 400.0, "torque": 6.0, "i": 120.0, "u": 12.0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return physical.SynchronousMotorSystem(
            supply=physical.IdealVoltageSupply(u_nominal=24.0),
            converter=physical.ContB6BridgeConverter(tau=TAU),
            motor=physical.PermanentMagnetSynchronousMotor(
                motor_parameter={
                    "p": m.pole_pairs, "l_d": m.ld, "l_q": m.lq, "j_rotor": m.inertia, "r_s": m.resistance,
                    "psi_p": m.flux,
                },
                nominal_values=limits,
                limit_values=limits,
            ),
            load=physical.PolynomialStaticLoad(load_parameter={"a": 0.02, "b": m.friction, "c": 0.0, "j_load": 1e-5}),
            ode_solver=solvers.EulerSolver(nsteps=2),
            tau=TAU,
            control_space="dq",
        )  # fmt: skip


@cache
def drive():
    """Samples each 1 ms as :func:`steering.drive.drive` has them; the steering wheel goes to and fro by itself."""
    m, system = GEM, _system(GEM)
    x = system.reset() * np.asarray(system.limits)
    at = {name: list(system.state_names).index(name) for name in ("omega", "epsilon", "i_sd", "i_sq", "u_sd", "u_sq")}
    wound, held, angle, last = 0.0, np.zeros(2), 0.0, float(x[at["epsilon"]])
    start = last
    rows, sums = [], np.zeros(2)
    for k in range(round(SECONDS / TAU)):
        t = k * TAU
        wanted = 60.0 * np.sin(2 * np.pi * 0.6 * t) * min(t / 0.5, 1.0)
        omega, i_d, i_q = x[at["omega"]], x[at["i_sd"]], x[at["i_sq"]]
        off = wanted - omega
        wound = np.clip(wound + 5.0 * off * TAU, -25.0, 25.0)
        error = np.array([-i_d, np.clip(0.25 * off + wound, -35, 35) - i_q])
        held += 900.0 * m.resistance * error * TAU
        turning = m.pole_pairs * omega
        u = 900.0 * m.ld * error + held + [-turning * m.lq * i_q, turning * (m.ld * i_d + m.flux)]
        x = system.simulate(np.clip(u / 12.0, -1, 1)) * np.asarray(system.limits)
        angle += (x[at["epsilon"]] - last + np.pi) % (2 * np.pi) - np.pi
        last = float(x[at["epsilon"]])
        sums += x[[at["u_sd"], at["u_sq"]]]
        if k % 10 == 9:
            theta = start + angle
            i_d, i_q = x[at["i_sd"]], x[at["i_sq"]]
            i_a = i_d * np.cos(theta) - i_q * np.sin(theta)
            i_b = i_d * np.sin(theta) + i_q * np.cos(theta)
            rows.append(
                [theta / m.pole_pairs, i_a, -0.5 * i_a + np.sqrt(0.75) * i_b, *(sums / 10), i_d, x[at["omega"]]]
            )
            sums = np.zeros(2)
    rows, rng = np.array(rows), np.random.default_rng(1)
    n = len(rows)
    t = np.arange(n) * 1e-3
    code = 2 * np.pi / 16384
    return {
        "sensor": np.rint((rows[:, 0] + rng.normal(0, 3e-4, n)) / code) * code,
        "true": rows[:, 0],
        "i_u": rows[:, 1] + rng.normal(0, 0.05, n),
        "i_v": rows[:, 2] + rng.normal(0, 0.05, n),
        "u_d": rows[:, 3], "u_q": rows[:, 4], "i_d": rows[:, 5], "omega": rows[:, 6],
        "wheel": 20.0 * np.sin(2 * np.pi * 0.5 * t), "rate": 20.0 * np.pi * np.cos(2 * np.pi * 0.5 * t),
    }  # fmt: skip
