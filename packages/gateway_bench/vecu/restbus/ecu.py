"""Frames of all messages that a rest bus sends, protected by the kernels that check them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, FD, Frames, empty
from gateway.signals.bits import mask_of
from gateway.signals.columns import limits, put_column
from gateway.signals.protection.protection import Protection, ProtectionConst, Tables, fill, protect_all
from gateway.signals.tables import DecodePlan, SignalRef, compile_plan
from gateway_bench.vecu.contract import EcuFault, Run, Truth, VirtualEcu
from gateway_bench.vecu.databases import database_of
from gateway_bench.vecu.restbus.courses import Course
from gateway_bench.vecu.restbus.params import RestbusParams
from gateway_bench.vecu.restbus.selection import sent
from gateway_bench.vecu.restbus.signals import Courses
from gateway_fdi.common.tomlfile import key_path
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

Values = NDArray[np.float64]
#: The golden ratio's part: messages of one cycle begin spread over it, not all at once.
_SPREAD = 0.6180339887498949


class _Senders:
    """Makes the frames of one message after the other.

    Args:
        params: of the ECU.
        run: its settings.
    """

    def __init__(self, params: RestbusParams, run: Run) -> None:
        self._params, self._run = params, run
        database = database_of(run.databases)
        self.sent = sent(params, database)
        names = {one.message.name: one for one in self.sent}
        self._courses = Courses(params.signals, database, names)
        refs = [
            SignalRef(run.bus, one.message.name, signal.name)
            for one in self.sent
            for signal in one.message.signals
            if signal.length <= 64
        ]
        self._plan: DecodePlan = compile_plan([(run.bus, database)], refs, messages=[(run.bus, name) for name in names])

    def frames(self, place: int) -> Frames:
        """Return the frames of one message.

        Args:
            place: of the message among those sent.
        """
        one = self.sent[place]
        message, run = one.message, self._run
        times = self._times(one.period_s, place * _SPREAD % 1.0)
        tables, rows = Tables(), np.zeros(1, ProtectionConst.dtype)
        fill(rows[0], one.protection, tables)
        row, crcs = rows.view(np.recarray)[0], tables.array()
        words = self._payloads(message, times, row)
        protect_all(words, np.full(len(times), message.length), row, crcs, 0)
        frames = empty(len(times))
        frames["t_ns"] = np.rint(times * 1e9)
        frames["can_id"] = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        frames["bus"], frames["length"] = run.bus, message.length
        frames["flags"] = FD if message.is_fd else 0
        frames["data"] = words.view(np.uint8)
        return frames

    def _times(self, period_s: float, phase: float) -> Values:
        """Return when the frames of a message are sent [s]."""
        first = phase * min(period_s, self._run.duration_s)
        times = first + np.arange(int((self._run.duration_s - first) / period_s) + 1) * period_s
        times = times[times < self._run.duration_s]
        if self._params.jitter_ms:
            times = times + self._run.rng.normal(0.0, self._params.jitter_ms * 1e-3, len(times))
        return np.sort(np.maximum(times, 0.0))

    def _row(self, message: Message, signal: Signal) -> Any:
        ref = SignalRef(self._run.bus, message.name, signal.name)
        row = self._plan.message(self._run.bus, message.name)
        return self._plan.signals[int(self._plan.messages["first"][row]) + self._plan.position(*ref)]

    def _payloads(self, message: Message, times: Values, row: Any) -> NDArray[np.uint64]:
        """Return payloads before their protection, shape (frames, 8), zero beyond the message's length.

        Signals with a course are written last: in databases whose signals overlap they are what is sent.
        """
        owned = int.from_bytes(np.ascontiguousarray(row.owned).tobytes(), "little")
        there: dict[str, NDArray[np.bool_]] = {}
        columns: dict[str, Values] = {}
        for signal in _parents_first(message):
            columns[signal.name] = self._values(message, signal, times, owned)
            there[signal.name] = _carried(signal, message, columns, there, len(times))
        words = np.zeros((len(times), 8), np.uint64)
        asked = {name for name in columns if self._courses.given(f"{message.name}.{name}")}
        for signal in sorted(message.signals, key=lambda signal: (signal.name in asked, signal.is_multiplexer)):
            if signal.name in columns:
                put_column(words, self._row(message, signal), columns[signal.name], there[signal.name])
        return words

    def _values(self, message: Message, signal: Signal, times: Values, owned: int) -> Values:
        """Return the values of a signal.

        Raises:
            InputError: it cannot carry them, or its protection makes it.
        """
        name, row = f"{message.name}.{signal.name}", self._row(message, signal)
        if not self._courses.given(name) and signal.is_multiplexer:
            return self._turns(message, signal, len(times))
        values = self._courses.at(name, times)
        low, high = limits(row)
        if self._courses.given(name):
            key = key_path(("signals", name))
            if mask_of(row) & owned:
                raise InputError("the message's protection makes this signal", key=key, value=name)
            slack = abs(float(row["scale"])) / 2
            wrong = values[(values < low - slack) | (values > high + slack)]
            if len(wrong):
                raise InputError(f"it can carry {low:g} to {high:g}", key=key, value=float(wrong[0]))
            noise = self._courses.noise(name)
            if noise:
                values = values + self._run.rng.normal(0.0, noise, len(values))
        return values

    def _turns(self, message: Message, multiplexer: Signal, count: int) -> Values:
        """Return a multiplexer's values: those that the database knows, one a frame, inner ones slower."""
        every = {one.name: one for one in message.signals}
        slower, outer = 1, multiplexer.multiplexer_signal
        while outer is not None:
            slower *= max(len(_ids(message, outer)), 1)
            outer = every[outer].multiplexer_signal
        ids = np.asarray(_ids(message, multiplexer.name) or [0], np.float64)
        raw = ids[np.arange(count) // slower % len(ids)]
        return np.asarray(raw * multiplexer.scale + multiplexer.offset, np.float64)


def _ids(message: Message, multiplexer: str) -> list[int]:
    """Return the values of a multiplexer that signals belong to."""
    selected = [one for one in message.signals if one.multiplexer_signal == multiplexer]
    return sorted({i for one in selected for i in one.multiplexer_ids or ()})


def _parents_first(message: Message) -> list[Signal]:
    """Return the signals of at most 64 bits, each multiplexer before what it selects."""
    left = [signal for signal in message.signals if signal.length <= 64]
    found: dict[str, Signal] = {}
    while left:
        ready = [one for one in left if one.multiplexer_signal is None or one.multiplexer_signal in found]
        if not ready:
            break  # of a multiplexer that cannot be sent
        found |= {one.name: one for one in ready}
        left = [one for one in left if one.name not in found]
    return list(found.values())


def _carried(
    signal: Signal, message: Message, columns: dict[str, Values], there: dict[str, NDArray[np.bool_]], count: int
) -> NDArray[np.bool_]:
    """Return which frames carry a signal."""
    if signal.multiplexer_signal is None:
        return np.ones(count, np.bool_)
    outer = message.get_signal_by_name(signal.multiplexer_signal)
    raw = np.rint((columns[outer.name] - outer.offset) / outer.scale)
    return there[outer.name] & np.isin(raw, signal.multiplexer_ids or [])


def _frames(params: RestbusParams, _faults: Sequence[EcuFault], run: Run) -> tuple[Frames, list[Truth]]:
    senders = _Senders(params, run)
    frames = np.concatenate([senders.frames(place) for place in range(len(senders.sent))])
    return frames[np.argsort(frames["t_ns"], kind="stable")], []


def _sends(params: RestbusParams, databases: Sequence[Path]) -> dict[str, Protection]:
    return {one.message.name: one.protection for one in sent(params, database_of(databases), tell=False)}


def _locate(params: RestbusParams, folder: Path, key: str) -> RestbusParams:
    """Return parameters whose CSV files and logs are those of the scenario's folder.

    Raises:
        InputError: there is no such file.
    """
    signals = dict(params.signals)
    for name, course in signals.items():
        if not isinstance(course, Course):
            continue
        for kind in ("csv", "log"):
            asked = getattr(course, kind)
            if asked is None:
                continue
            file = folder / asked.file
            if not file.is_file():
                where = f"{key}.{key_path(('signals', name))}.{kind}.file"
                raise InputError("there is no such file", key=where, value=str(asked.file))
            signals[name] = course.model_copy(update={kind: asked.model_copy(update={"file": file})})
    return params.model_copy(update={"signals": signals})


ECU = VirtualEcu(
    type="restbus",
    api=2,
    params=RestbusParams,
    fault=None,
    frames=_frames,
    sends=_sends,
    locate=_locate,
    step_ns=1_000_000,
)
