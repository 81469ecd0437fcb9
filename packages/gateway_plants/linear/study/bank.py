"""Our bank on the paper's plant: its own kernels on samples of a simulated run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import zeros
from gateway_plants.linear.arrays import Found, exact, walk
from gateway_plants.linear.ecu.params import LinearFault, LinearParams, Swing
from gateway_plants.linear.ecu.plant import simulate
from gateway_plants.linear.model_set import decision, records
from gateway_plants.linear.pi_bank.design import Noise
from gateway_plants.linear.study import example

Array = NDArray[np.float64]

#: State feedback that keeps the plant stable over hours.
FEEDBACK = ((0.234, -0.429, 1.234, -1.06), (0.183, 0.005, -0.23, 0.446))
#: Mean time between false alarms that is asked for [s].
MTFA = 1e6


def noise() -> Noise:
    """Return the noise that the bank is designed for: that of configs/linear_aircraft.toml."""
    drift = 0.1 * example.ACTUATOR_LIMIT
    return Noise(np.full(3, example.NOISE), np.full(4, 1e-4), np.full(2, drift))


def bank_of(start_s: float) -> tuple[Any, Any]:
    """Return state and constants of a bank before its first sample."""
    s, c = zeros(1, records.State)[0], zeros(1, records.Const)[0]
    limits = np.full(2, example.ACTUATOR_LIMIT), np.full(3, example.SENSOR_LIMIT)
    told = exact(example.A, example.B, example.plant(), noise(), *limits, discrete=False)
    decision.prepare(s, c, told, mtfa_s=MTFA, start_s=start_s, hold_s=2.0)
    return s, c


#: Samples of a long flight whose noise is drawn at a time.
PORTION = 100_000


def drive(noise_std: float, *, stable: bool) -> LinearParams:
    """Return the plant with the paper's constant commands, or with a controller and moving ones."""
    swings = (
        (Swing(amplitude=0.5, period_s=21.0), Swing(amplitude=0.5, period_s=13.0))
        if stable
        else (Swing(offset=example.COMMAND),) * 2
    )
    return LinearParams(
        type="linear",
        sensors="Aircraft_Sensors",
        commands="Aircraft_Command",
        sample_ms=1e3 * example.PERIOD,
        a=example.A,
        b=example.B,
        c=example.C,
        feedback=FEEDBACK if stable else None,
        swing=swings,
        noise=(noise_std,) * 3,
    )


def run(faults: tuple[LinearFault, ...], noise_std: float, rng: np.random.Generator) -> Found:
    """Return what the bank finds in the paper's 12 s."""
    y, u = simulate(drive(noise_std, stable=False), faults, example.DURATION, rng)
    return walk(*bank_of(1.0), y, u)


@dataclass(frozen=True)
class Quiet:
    """A healthy flight.

    Attributes:
        noise: standard deviation of each sensor.
        hours: judged.
        alarms: flags of actuators that went up, of sensors, and changes that were not isolated.
        seed: of the noise.
    """

    noise: float
    hours: float
    alarms: int
    seed: int


def quiet(sigma: float, hours: float, seed: int) -> Quiet:
    """Fly healthy with moving commands, and count the alarms: flags that go up."""
    plant, feedback, rng = example.plant(), np.array(FEEDBACK), np.random.default_rng(seed)
    count, judged, alarms = round(hours * 3600 / example.PERIOD), 0, 0
    bank, x = bank_of(5.0), np.zeros(plant.states)
    before: Any = np.zeros((1, 4), np.int64)
    closed = plant.phi - plant.gamma @ feedback
    for first in range(0, count, PORTION):
        k = np.arange(first, min(first + PORTION, count))
        asked = 0.5 * np.sin(0.03 * k[:, None] * np.array([1.0, 1.6]))
        states = np.empty((len(k), plant.states))
        for t, demand in enumerate(asked @ plant.gamma.T):
            states[t] = x
            x = closed @ x + demand
        y = states @ plant.c.T + rng.normal(0.0, sigma, (len(k), plant.outputs))
        found = walk(*bank, y, asked - states @ feedback.T)
        flags = np.column_stack([found.actuators, found.sensors.any(axis=1), found.unexplained])
        alarms += int((np.diff(flags, axis=0, prepend=before) > 0).sum())
        judged, before = judged + int(found.tested.sum()), flags[-1:]
    return Quiet(sigma, judged * example.PERIOD / 3600, alarms, seed)
