"""Frames of any message of a database, encoded by cantools, protected by the kernels that check them."""

from __future__ import annotations

from collections.abc import Sequence

import cantools
import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, FD, Frames, empty, put
from gateway.errors import InputError
from gateway.signals.database import Database, load_database
from gateway.signals.protection.params import protection_for
from gateway.signals.protection.protection import ProtectionConst, Tables, fill, protect_all
from gateway.vecu.contract import Run, Truth, VirtualEcu
from gateway.vecu.table.params import Course, TableFault, TableMessage, TableParams


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


def _raw(signal: Signal, value: float) -> float:
    """Return the nearest value that a signal can carry."""
    if signal.is_float:
        return value
    bits = signal.length - signal.is_signed
    low, high = (-(1 << bits) if signal.is_signed else 0), (1 << bits) - 1
    raw = min(max(round((value - signal.offset) / signal.scale), low), high)
    return float(raw * signal.scale + signal.offset)


def _payloads(message: Message, columns: dict[str, NDArray[np.float64]], count: int) -> NDArray[np.uint64]:
    """Return payloads, shape (frames, 8) uint64, zero beyond the message's length."""
    words = np.zeros((count, 8), np.uint64)
    signals = {signal.name: signal for signal in message.signals}
    for k in range(count):
        values = {name: _raw(signal, 0.0) for name, signal in signals.items()}
        values |= {name: _raw(signals[name], float(column[k])) for name, column in columns.items()}
        try:
            data = message.encode(values, scaling=True, strict=False)
        except cantools.database.EncodeError as error:
            raise InputError(f"cannot be sent: {error}", value=message.name) from error
        words[k] = np.frombuffer(bytes(data).ljust(64, b"\0"), "<u8")
    return words


def _columns(
    params: TableMessage,
    message: Message,
    times: NDArray[np.float64],
    faults: Sequence[TableFault],
    run: Run,
    truth: list[Truth],
) -> dict[str, NDArray[np.float64]]:
    """Return the values of a message's signals, faults in them.

    Raises:
        InputError: a signal that the message does not have.
    """
    known = {signal.name for signal in message.signals}
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
    for name in asked:
        if name not in known:
            raise InputError(f"{params.name} has no such signal; it has {', '.join(sorted(known))}", value=name)
    return asked


def _message(
    params: TableMessage, database: Database, faults: Sequence[TableFault], run: Run, truth: list[Truth]
) -> Frames:
    message = database.message(params.name)
    count = int(run.duration_s * 1e3 / params.period_ms) + 1
    times = np.asarray(np.arange(count) * params.period_ms * 1e-3, np.float64)
    words = _payloads(message, _columns(params, message, times, faults, run, truth), count)
    tables, rows = Tables(), np.zeros(1, ProtectionConst.dtype)
    fill(rows[0], protection_for(message, params), tables)
    protect_all(words, np.full(count, message.length), rows.view(np.recarray)[0], tables.array(), 0)
    can_id = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    frames = empty(count)
    for k in range(count):
        data = words[k].tobytes()[: message.length]
        put(frames, k, round(times[k] * 1e9), can_id, data, bus=run.bus, flags=FD if message.is_fd else 0)
    return frames


def _frames(params: TableParams, faults: Sequence[TableFault], run: Run) -> tuple[Frames, list[Truth]]:
    database = load_database(run.databases)
    names = [message.name for message in params.message]
    for fault in faults:
        if fault.signal.rpartition(".")[0] not in names:
            raise InputError(f"the ECU sends {', '.join(names)}", key="fault.signal", value=fault.signal)
    made: list[Frames] = []
    truth: list[Truth] = []
    for k, message in enumerate(params.message):
        try:
            made.append(_message(message, database, faults, run, truth))
        except InputError as error:
            key = f"message[{k}]" + (f".{error.key}" if error.key else "")
            raise InputError(error.message, key=key, value=error.value) from error
    frames = np.concatenate(made)
    return frames[np.argsort(frames["t_ns"], kind="stable")], truth


ECU = VirtualEcu(type="table", api=2, params=TableParams, fault=TableFault, frames=_frames)
