"""Frames of all messages that a rest bus sends, protected by the kernels that check them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.signals.bits import mask_of
from gateway.signals.columns import limits
from gateway.signals.frame_encoding import framed, parents_first, payloads
from gateway.signals.protection.protection import Protection, compiled
from gateway.signals.ranges import runs
from gateway.signals.tables import signal_row
from gateway_bench.vecu.contract import EcuFault, Run, Truth, VirtualEcu
from gateway_bench.vecu.databases import database_of
from gateway_bench.vecu.restbus.courses import Course
from gateway_bench.vecu.restbus.params import RestbusParams
from gateway_bench.vecu.restbus.selection import Sent, sent
from gateway_bench.vecu.restbus.signals import Courses
from gateway_fdi.common.tomlfile import key_path
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

Values = NDArray[np.float64]
#: Further values of a range of multiplexer values that are sent.
MOST_OF_A_RANGE = 255
#: The golden ratio's part: messages of one cycle begin spread over it, not all at once.
_SPREAD = 0.6180339887498949


class _Senders:
    """Makes the frames of one message after the other."""

    def __init__(self, params: RestbusParams, run: Run) -> None:
        self._params, self._run = params, run
        database = database_of(run.databases)
        self.sent = sent(params, database)
        names = {one.message.name: one for one in self.sent}
        self._courses = Courses(params.signals, database, names)

    def frames(self, place: int) -> Frames:
        """Return the frames of one message.

        Args:
            place: of the message among those sent.
        """
        one = self.sent[place]
        message, run = one.message, self._run
        times = self._times(one.period_s, place * _SPREAD % 1.0)
        return framed(message, self._payloads(one, times), times * 1e9, one.protection, bus=run.bus)

    def _times(self, period_s: float, phase: float) -> Values:
        """Return when the frames of a message are sent [s]."""
        first = phase * min(period_s, self._run.duration_s)
        times = first + np.arange(int((self._run.duration_s - first) / period_s) + 1) * period_s
        times = times[times < self._run.duration_s]
        if self._params.jitter_ms:
            times = times + self._run.rng.normal(0.0, self._params.jitter_ms * 1e-3, len(times))
        return np.sort(np.maximum(times, 0.0))

    def _payloads(self, one: Sent, times: Values) -> NDArray[np.uint64]:
        """Return payloads before their protection, shape (frames, 8), zero beyond the message's length.

        Signals with a course are written last: in databases whose signals overlap they are what is sent.
        """
        message = one.message
        owned = int.from_bytes(np.ascontiguousarray(compiled(one.protection)[0]["owned"]).tobytes(), "little")
        columns = {signal.name: self._values(message, signal, times, owned) for signal in parents_first(message)}
        asked = frozenset(name for name in columns if self._courses.given(f"{message.name}.{name}"))
        return payloads(message, columns, len(times), asked)

    def _values(self, message: Message, signal: Signal, times: Values, owned: int) -> Values:
        """Return the values of a signal.

        Raises:
            InputError: it cannot carry them, or its protection makes it.
        """
        name, row = f"{message.name}.{signal.name}", signal_row(signal)
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
    """Return the values of a multiplexer that signals belong to; of wide ranges the first ones."""
    selected = [one for one in message.signals if one.multiplexer_signal == multiplexer]
    pairs = [pair for one in selected for pair in runs(one.multiplexer_ids or ())]
    return sorted({i for low, high in pairs for i in range(low, min(high, low + MOST_OF_A_RANGE) + 1)})


def _frames(params: RestbusParams, _faults: Sequence[EcuFault], run: Run) -> tuple[Frames, list[Truth]]:
    senders = _Senders(params, run)
    frames = np.concatenate([senders.frames(place) for place in range(len(senders.sent))])
    return frames[np.argsort(frames["t_ns"], kind="stable")], []


def _sends(params: RestbusParams, databases: Sequence[Path]) -> dict[str, Protection]:
    return {one.message.name: one.protection for one in sent(params, database_of(databases), log=False)}


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
