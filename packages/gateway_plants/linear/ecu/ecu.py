"""The ECU of a linear plant: sensors and commands as frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from numpy.typing import ArrayLike

from gateway.bus.frames import Frames, empty
from gateway.signals import frame_encoding as encode
from gateway.signals.database import Database, load_database
from gateway_bench.vecu.contract import Run, Truth, VirtualEcu, injected
from gateway_fdi.common.resources import find, shipped
from gateway_fdi.errors import InputError, under
from gateway_plants.linear.ecu.params import LinearFault, LinearParams
from gateway_plants.linear.ecu.plant import simulate

#: Signals that are not the plant's.
_COUNTER = "FrameCnt"
_OWN = ("Crc", _COUNTER)
#: Database of the shipped plants.
DATABASE = "dbc/linear.dbc"
#: The sensors' frame follows that of the commands [ns].
_AFTER = 300_000


def _database(params: LinearParams, databases: Sequence[Path]) -> Database:
    """Load the database that it names, else those of its bus, else the shipped one."""
    if params.database is not None:
        given = params.database
        return load_database([given if given.exists() else shipped(str(given))])
    return load_database(databases or [shipped(DATABASE)])


def _signals(message: Message, count: int) -> list[Signal]:
    """Return the signals that carry the plant, in their order in the message.

    Raises:
        InputError: not so many, or not all of them in every frame.
    """
    if message.is_multiplexed():
        raise InputError("a multiplexed message cannot carry a plant: its signals must come together")
    found = [signal for signal in message.signals if signal.name not in _OWN]
    found.sort(key=lambda signal: signal.start)
    if len(found) != count:
        names = ", ".join(signal.name for signal in found)
        raise InputError(
            f"this message has {len(found)} signals besides {' and '.join(_OWN)} ({names}), the plant has {count}"
        )
    return found


def _frames(params: LinearParams, faults: Sequence[LinearFault], run: Run) -> tuple[Frames, list[Truth]]:
    database = _database(params, run.databases)
    outputs, commands = simulate(params, tuple(faults), run.duration_s, run.rng)
    period = params.sample_ms * 1e6
    frames = empty(2 * len(outputs))
    late = np.clip(np.abs(run.rng.normal(0.0, params.jitter_us * 1e3, len(frames))), 0.0, 0.1 * _AFTER)
    for first, key, name, columns in (
        (0, "commands", params.commands, commands),
        (1, "sensors", params.sensors, outputs),
    ):
        with under(key, name):
            message = database.message(name)
            signals = _signals(message, columns.shape[1])
            values: dict[str, ArrayLike] = {signal.name: columns[:, k] for k, signal in enumerate(signals)}
            for counter in (one for one in message.signals if one.name == _COUNTER):
                values[_COUNTER] = np.arange(len(columns)) % 2.0**counter.length
            stamps = np.round(np.arange(len(columns)) * period) + first * _AFTER + np.round(late[first::2])
            frames[first::2] = encode.frames_of(message, values, stamps, bus=run.bus)
    times = [(fault.kind, fault.from_s, fault.to_s) for fault in faults]
    return frames, injected(times, run.duration_s, params.sample_ms * 1e-3)


def _fits(params: LinearParams, fault: LinearFault) -> None:
    acts = fault.kind.startswith("actuator")
    count = params.plant.inputs if acts else params.plant.outputs
    if fault.place > count:
        raise ValueError(f"ECU {params.name!r} has no place {fault.place} for {fault.kind}")


def _locate(params: LinearParams, folder: Path, key: str) -> LinearParams:
    """Return the parameters with the path of their database: beside the scenario, else among the shipped."""
    if params.database is None:
        return params
    found = find(params.database, folder, "dbc", ".dbc", beside="the scenario", key=f"{key}.database")
    return params.model_copy(update={"database": found})


ECU = VirtualEcu(
    type="linear",
    api=2,
    params=LinearParams,
    fault=LinearFault,
    frames=_frames,
    fits=_fits,
    locate=_locate,
)
