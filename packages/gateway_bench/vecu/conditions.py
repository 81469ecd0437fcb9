"""Conditions on signals: the texts and the machine of the monitor ``rule``, on the frames of a bus as they come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.signals.database import Database
from gateway.signals.decode import decode, lookup
from gateway.signals.signal_access import words_of
from gateway.signals.tables import SignalRef, compile_plan
from gateway_checks.rule.machine import Code, Machine, load, run
from gateway_checks.rule.text import compile_text, is_relation
from gateway_fdi.errors import InputError


class Condition:
    """Whether a relation of signals holds, at any time of the frames taken last.

    Signals have the value that came last; before all have come it does not hold.

    Args:
        text: e.g. ``"Drive.Speed > 50 and Gear.Actual == 3"``.
        bus: index of the bus.
        database: of the bus.

    Raises:
        InputError: text that is no relation, or names signals that are not there.
    """

    def __init__(self, text: str, bus: int, database: Database) -> None:
        def unit_of(name: str) -> str | None:
            message, _, own = name.rpartition(".")
            return str(database.signal(message, own).unit or "") or None

        program = compile_text(text, unit_of)
        if not is_relation(text):
            raise InputError("a condition compares: Message.Signal > 50", value=text)
        refs = [SignalRef(bus, *name.rpartition(".")[::2]) for name in program.signals]
        self._plan = compile_plan([(bus, database)], refs)
        self._refs, self._bus = refs, bus
        machine, code = (np.zeros(1, record.dtype) for record in (Machine, Code))
        load(machine[0], code[0], program, program.signals)
        self._machine, self._code = machine.view(np.recarray)[0], code.view(np.recarray)[0]
        self._values = np.full(max(len(refs), 1), np.nan)
        self._places = {row: self._columns(row) for row in range(len(self._plan.message_names))}
        self._times, self._true = np.zeros(0, np.int64), np.zeros(1, np.bool_)

    def _columns(self, row: int) -> list[tuple[int, int]]:
        """Return where the signals of a message stand among those decoded of it, and among the condition's."""
        name = self._plan.message_names[row][1]
        return [(self._plan.position(*ref), k) for k, ref in enumerate(self._refs) if ref.message == name]

    def take(self, frames: Frames) -> None:
        """Take the next frames of all buses, in order of time."""
        last = bool(self._true[-1])
        times: list[int] = []
        true = [last]
        keys = self._plan.keys, self._plan.rows
        found = {int(i): lookup(*keys, self._bus, int(i)) for i in np.unique(frames["can_id"])}
        mine = np.isin(frames["can_id"], [i for i, row in found.items() if row >= 0]) & (frames["bus"] == self._bus)
        for frame in frames[mine]:
            self._decode(frame, found[int(frame["can_id"])])
            result = run(self._machine, self._code, int(frame["t_ns"]), self._values, 0.0)
            known = not np.isnan(self._values[: len(self._refs)]).any() and not self._machine.unknown
            times.append(int(frame["t_ns"]))
            true.append(bool(known and result))
        self._times, self._true = np.asarray(times, np.int64), np.asarray(true, np.bool_)

    def _decode(self, frame: np.void, row: int) -> None:
        plan = self._plan
        count = int(plan.messages[row]["count"])
        values, present = np.full(count, np.nan), np.zeros(count, np.uint8)
        length = int(frame["length"])
        decode(words_of(frame), length, row, plan.messages, plan.signals, plan.mux_ids, values, present)
        for place, k in self._places[row]:
            if present[place]:
                self._values[k] = values[place]

    @property
    def messages(self) -> list[str]:
        """Messages that its signals are in."""
        return [name for _, name in self._plan.message_names]

    def spans(self) -> list[tuple[int, int | None]]:
        """Return from when until when it holds among the frames taken last [ns]; None: beyond the last of them."""
        edges = np.flatnonzero(self._true[1:] != self._true[:-1])
        times: list[int | None] = [int(self._times[k]) for k in edges]
        if self._true[0]:
            times.insert(0, 0)
        begins = [t for t in times[::2] if t is not None]
        return list(zip(begins, [*times[1::2], None], strict=False))

    def holds(self, t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return whether it holds at some times [ns], which lie not before the frames taken last."""
        return np.asarray(self._true[np.searchsorted(self._times, t_ns, side="right")], np.bool_)


def within(
    t_ns: NDArray[np.int64], from_s: float | None, to_s: float | None, condition: Condition | None
) -> NDArray[np.bool_]:
    """Tell at which of some times a fault is there: between two times, while its condition holds.

    Args:
        t_ns: times [ns].
        from_s: its begin [s]; None: 0.
        to_s: its end [s]; None: never.
        condition: None: always.
    """
    hit = t_ns >= round((from_s or 0.0) * 1e9)
    if to_s is not None:
        hit &= t_ns < round(to_s * 1e9)
    if condition is not None:
        hit &= condition.holds(t_ns)
    return np.asarray(hit, np.bool_)
