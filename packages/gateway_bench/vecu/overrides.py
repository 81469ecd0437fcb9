"""Signals that are set while virtual ECUs run: by a test, or by the control channel of ``gateway simulate``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gateway.bus.frames import Frames
from gateway.signals.columns import limits
from gateway.signals.signal_access import ChangedMessage, ChangedSignal, words_of
from gateway_bench.vecu.harness import Sender
from gateway_fdi.errors import InputError, named


@dataclass
class _Set:
    message: ChangedMessage
    signal: ChangedSignal
    value: float


class Overrides:
    """Values in place of the courses of signals, until they are released; faults are put over them.

    Args:
        senders: messages of the ECUs.
        buses: name -> index of the buses.
    """

    def __init__(self, senders: Sequence[Sender], buses: Mapping[str, int]) -> None:
        self._senders, self._buses = senders, buses
        self._set: dict[tuple[int, str], _Set] = {}

    @property
    def values(self) -> dict[str, float]:
        """Signals that are set, with their values."""
        return {name: one.value for (_, name), one in self._set.items()}

    def set(self, values: Mapping[str, float | str]) -> None:
        """Give signals values from their next frames on: all of them, or, if one is wrong, none.

        Args:
            values: "Message.Signal", or "bus.Message.Signal", -> in the signal's unit, or its text in the database.

        Raises:
            InputError: no such signal, or a value that it cannot carry.
        """
        self._set.update([self._made(name, value) for name, value in values.items()])

    def _made(self, name: str, value: float | str) -> tuple[tuple[int, str], _Set]:
        sender, own = self._sender(name)
        made = _Set(sender.message(own.rpartition(".")[0]), sender.signal(own), 0.0)
        made.value = _number(value, sender, own)
        low, high = limits(made.signal.row)
        slack = abs(float(made.signal.row.scale)) / 2
        if not low - slack <= made.value <= high + slack:
            raise InputError(f"it can carry {low:g} to {high:g}", key=own, value=value)
        return (sender.bus, own), made

    def release(self, name: str | None = None) -> None:
        """Let a signal go its course again; None: all of them.

        Raises:
            InputError: it is not set.
        """
        if name is None:
            self._set.clear()
            return
        sender, own = self._sender(name)
        if (sender.bus, own) not in self._set:
            raise InputError(named("set are", own, self.values), key="release", value=name)
        del self._set[sender.bus, own]

    def _sender(self, name: str) -> tuple[Sender, str]:
        """Return whose signal it is, and its name without the bus.

        Raises:
            InputError: it names no bus where there are several.
        """
        first, _, rest = name.partition(".")
        senders = self._senders
        if first in self._buses and "." in rest:
            senders = [one for one in senders if one.bus == self._buses[first]]
            if not senders:
                raise InputError("no virtual ECU sends on this bus", key="bus", value=first)
            name = rest
        message = name.rpartition(".")[0]
        having = [one for one in senders if one.has(message)]
        if len({one.bus for one in having}) > 1:
            raise InputError("several buses have this message: bus.Message.Signal", value=name)
        return (having or list(senders))[0], name

    def apply(self, frames: Frames) -> Frames:
        """Return frames with the values that are set."""
        for one in self._set.values() if len(frames) else ():
            mine = np.flatnonzero(one.message.among(frames))
            frames = frames.copy() if len(mine) else frames
            for k in mine:
                words, length = words_of(frames[k]), int(frames[k]["length"])
                if np.isnan(one.signal.value(words, length)):
                    continue  # this frame does not carry it
                one.signal.put(words, one.value)
                one.message.renew(words, length)
                frames[k]["data"] = words.view(np.uint8)
        return frames


def _number(value: float | str, sender: Sender, name: str) -> float:
    if not isinstance(value, str):
        try:
            number = float("nan") if isinstance(value, bool) else float(value)
        except OverflowError:  # an int of many digits
            number = float("inf")
        if not np.isfinite(number):
            raise InputError("a number, or a text of the database", key=name, value=value)
        return number
    message, _, own = name.rpartition(".")
    signal = sender.database.signal(message, own)
    texts = {str(text): float(raw * signal.scale + signal.offset) for raw, text in (signal.choices or {}).items()}
    if value not in texts:
        raise InputError(named("its texts are", value, texts), key=name, value=value)
    return texts[value]
