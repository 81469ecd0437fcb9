"""Frames of any message of a database, encoded by cantools, protected by the kernels that check them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.signals.database import Database, load_database
from gateway.signals.frame_encoding import sent
from gateway_bench.vecu.contract import Run, Truth, VirtualEcu
from gateway_bench.vecu.table.params import Course, TableFault, TableMessage, TableParams
from gateway_fdi.errors import InputError, under


def _course(course: Course, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a signal's values at some times [s]."""
    if isinstance(course, tuple):
        points = np.asarray(course)
        return np.asarray(np.interp(times, points[:, 0], points[:, 1]), np.float64)
    return np.full(len(times), course)


def _faulty(
    values: NDArray[np.float64], times: NDArray[np.float64], fault: TableFault, rng: np.random.Generator
) -> tuple[NDArray[np.float64], int]:
    """Return values with a fault in them, and how many are concerned."""
    inside = times >= fault.from_s
    if fault.to_s is not None:
        inside &= times < fault.to_s
    made = values.copy()
    if fault.kind == "value":
        made[inside] = fault.size
    elif fault.kind == "offset":
        made[inside] += fault.size
    elif fault.kind == "noise":
        made[inside] += rng.normal(0.0, fault.size, int(inside.sum()))
    elif inside.any():
        made[inside] = values[np.flatnonzero(inside)[0]]
    return made, int(inside.sum())


def _columns(
    params: TableMessage,
    times: NDArray[np.float64],
    faults: Sequence[TableFault],
    run: Run,
    truth: list[Truth],
) -> dict[str, NDArray[np.float64]]:
    """Return the values of a message's signals, faults in them."""
    asked = {name: _course(course, times) for name, course in params.signals.items()}
    asked |= {name: np.resize(np.asarray(values), len(times)) for name, values in params.turns.items()}
    for name, deviation in params.noise.items():
        asked[name] = asked.get(name, np.zeros(len(times))) + run.rng.normal(0.0, deviation, len(times))
    for fault in faults:
        of, _, name = fault.signal.rpartition(".")
        if of == params.name:
            values = asked.get(name, np.zeros(len(times)))
            asked[name], count = _faulty(values, times, fault, run.rng)
            truth.append(Truth(round(fault.from_s * 1e9), fault.kind, count))
    return asked


def _message(
    params: TableMessage, database: Database, faults: Sequence[TableFault], run: Run, truth: list[Truth]
) -> Frames:
    message = database.message(params.name)
    count = int(run.duration_s * 1e3 / params.period_ms) + 1
    times = np.asarray(np.arange(count) * params.period_ms * 1e-3, np.float64)
    return sent(message, _columns(params, times, faults, run, truth), times, params, bus=run.bus)


def _frames(params: TableParams, faults: Sequence[TableFault], run: Run) -> tuple[Frames, list[Truth]]:
    database = load_database(run.databases)
    names = [message.name for message in params.message]
    for fault in faults:
        if fault.signal.rpartition(".")[0] not in names:
            raise InputError(f"the ECU sends {', '.join(names)}", key="fault.signal", value=fault.signal)
    made: list[Frames] = []
    truth: list[Truth] = []
    for k, message in enumerate(params.message):
        with under(f"message[{k}]"):
            made.append(_message(message, database, faults, run, truth))
    frames = np.concatenate(made)
    return frames[np.argsort(frames["t_ns"], kind="stable")], truth


ECU = VirtualEcu(type="table", api=2, params=TableParams, fault=TableFault, frames=_frames)
