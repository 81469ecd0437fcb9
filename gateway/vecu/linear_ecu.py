"""The ECU of a linear plant: sensors and commands as frames."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gateway.bus.frames import Frames, empty, put
from gateway.errors import InputError
from gateway.resources import shipped
from gateway.signals.database import load_database
from gateway.vecu.linear_params import LinearFault, LinearParams
from gateway.vecu.linear_plant import simulate
from gateway.vecu.protection import protect
from gateway.vecu.pulse_faults import Truth

#: Signals that are not the plant's.
_OWN = ("Crc", "FrameCnt")
#: The sensors' frame follows that of the commands [ns].
_AFTER = 300_000


def linear_frames(
    params: LinearParams,
    faults: Iterable[LinearFault],
    duration_s: float,
    *,
    bus: int,
    rng: np.random.Generator,
) -> tuple[Frames, list[Truth]]:
    """Return all frames of a run, stamped from time 0, and what was injected.

    Args:
        params: the plant.
        faults: of its actuators and sensors.
        duration_s: length of the run [s].
        bus: index of its bus.
        rng: source of all randomness.

    Raises:
        InputError: the database has no such message, or it has not one signal for each output or input.
    """
    faults = tuple(faults)
    path = params.database if params.database.exists() else shipped(str(params.database))
    database = load_database([path])
    outputs, commands = simulate(params, faults, duration_s, rng)
    period = params.sample_ms * 1e6
    frames = empty(2 * len(outputs))
    late = np.clip(np.abs(rng.normal(0.0, params.jitter_us * 1e3, len(frames))), 0.0, 0.1 * _AFTER)
    for first, key, name, columns in (
        (0, "commands", params.commands, commands),
        (1, "sensors", params.sensors, outputs),
    ):
        message = database.message(name)
        signals = [signal for signal in message.signals if signal.name not in _OWN]
        signals.sort(key=lambda signal: signal.start)
        if len(signals) != columns.shape[1]:
            raise InputError(
                f"{name} has {len(signals)} signals, the plant {columns.shape[1]} {key}",
                key=key,
                value=name,
            )
        for k, row in enumerate(columns):
            values: dict[str, float] = {
                signal.name: float(np.clip(value, signal.minimum, signal.maximum))
                for signal, value in zip(signals, row, strict=True)
            }
            stamp = round(k * period) + first * _AFTER + round(late[2 * k + first])
            data = protect(message, {"FrameCnt": k % 16, **values})
            put(frames, 2 * k + first, stamp, message.frame_id, data, bus=bus)
    truth = []
    for fault in faults:
        end = duration_s if fault.to_s is None else min(fault.to_s, duration_s)
        if fault.from_s < end:
            count = round((end - fault.from_s) * 1e3 / params.sample_ms)
            truth.append(Truth(round(fault.from_s * 1e9), fault.kind, count))
    return frames, truth
