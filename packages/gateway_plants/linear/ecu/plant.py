"""A linear plant with a controller, faults of its actuators and sensors: what its sensors and commands say.

Faults are additive (paper 003, (4)). An actuator's begins anywhere within a sample; the plant is integrated exactly up
to there and from there on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway_plants.linear.ecu.params import LinearFault, LinearParams
from gateway_plants.linear.mathematics.plant import discretised

Array = NDArray[np.float64]


def _actuators(faults: tuple[LinearFault, ...], inputs: int, t: float) -> Array:
    """Return what is added to the commands at a time [s]."""
    added = np.zeros(inputs)
    for fault in faults:
        if fault.kind.startswith("actuator") and fault.from_s <= t + 1e-9:
            if fault.to_s is not None and t >= fault.to_s - 1e-9:
                continue
            drifts = fault.kind == "actuator_drift"
            added[fault.place - 1] += fault.size * (t - fault.from_s if drifts else 1.0)
    return added


def _sensors(faults: tuple[LinearFault, ...], y: Array, t: float, held: dict[int, float]) -> Array:
    """Return what the sensors say of ``y`` at a time [s]; ``held`` keeps what a stuck one said first."""
    said = y.copy()
    for number, fault in enumerate(faults):
        place = fault.place - 1
        if fault.kind.startswith("actuator") or t < fault.from_s - 1e-9:
            continue
        if fault.to_s is not None and t >= fault.to_s - 1e-9:
            continue
        if fault.kind == "output_offset":
            said[place] += fault.size
        elif fault.kind == "output_drift":
            said[place] += fault.size * (t - fault.from_s)
        else:
            said[place] = held.setdefault(number, float(y[place]))
    return said


def simulate(
    params: LinearParams,
    faults: tuple[LinearFault, ...],
    duration_s: float,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Return outputs (n, p) and commands (n, m), a row a sample from time 0 on.

    Args:
        params: the plant, which begins in state 0.
        faults: of actuators and sensors.
        duration_s: length of the run [s].
        rng: source of all randomness.
    """
    plant = params.plant
    period, count = plant.period, round(duration_s / plant.period)
    noise = np.array(params.noise or (0.0,) * plant.outputs)
    feedback = np.zeros((plant.inputs, plant.states)) if params.feedback is None else np.array(params.feedback)
    x, held = np.zeros(plant.states), dict[int, float]()
    outputs, commands = np.empty((count, plant.outputs)), np.empty((count, plant.inputs))
    edges = [fault.from_s for fault in faults if fault.kind.startswith("actuator")]
    edges += [f.to_s for f in faults if f.kind.startswith("actuator") and f.to_s is not None]
    for k in range(count):
        t = k * period
        outputs[k] = _sensors(faults, plant.c @ x + rng.normal(0.0, noise), t, held)
        asked = [s.offset + s.amplitude * np.sin(2 * np.pi * t / s.period_s) for s in params.swing]
        commands[k] = (np.array(asked) if asked else np.zeros(plant.inputs)) - feedback @ x
        inside = sorted(e for e in edges if t + 1e-9 < e < t + period - 1e-9)
        for begin, end in zip([t, *inside], [*inside, t + period], strict=True):
            part = plant if not inside else discretised(params.a, params.b, params.c, end - begin)
            added = _actuators(faults, plant.inputs, begin)
            x = part.phi @ x + part.gamma @ (commands[k] + added)
        x = x + rng.normal(0.0, params.state_noise * np.sqrt(period), plant.states)
    return outputs, commands
