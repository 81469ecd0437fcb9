"""Alive counters, by what signals do: one up a frame, modulo a number that is learned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.signals.protection.params import COUNTERS

#: Longest counter that is looked for [bit], and steps that it takes to be sure.
MOST_BITS, LEAST_STEPS = 32, 32
#: Share of the steps that may be others: frames that the log lost.
LOST = 0.02
#: Largest step that is taken for a loss.
LONGEST_LOSS = 8


@dataclass(frozen=True)
class CounterFound:
    """A counter.

    Attributes:
        signal: its name.
        first: the lowest of its values.
        modulus: how many it has.
        steps: that were looked at.
        ones: of these, those by one.
        wraps: how often it came round; 0: what it has after its highest bits are set is not known, all are assumed.
        lost: frames that are missing between steps.
    """

    signal: str
    first: int
    modulus: int
    steps: int
    ones: int
    wraps: int
    lost: int

    def keys(self, bits: int) -> dict[str, Any]:
        """Return it as a configuration has it; ``bits``: length of the signal."""
        keys: dict[str, Any] = {"signal": self.signal}
        if self.modulus != (1 << bits) - self.first:
            keys["modulus"] = self.modulus
        if self.first:
            keys["first"] = self.first
        return keys


def signal_of(message: Message, counter: CounterFound) -> Signal:
    """Return the signal that counts."""
    return next(signal for signal in message.signals if signal.name == counter.signal)


def called_counter(name: str) -> bool:
    """Tell whether a signal is called as counters are."""
    return name.upper().rstrip("0123456789_").endswith(COUNTERS)


def of_raw(name: str, raw: NDArray[np.int64], follows: NDArray[np.bool_], bits: int) -> CounterFound | None:
    """Tell whether a field counts.

    Args:
        name: of the signal.
        raw: its values, frame by frame.
        follows: shape (frames - 1,), whether nothing lies between a frame and the next.
        bits: its length.

    Returns:
        None: it does not, or not surely.
    """
    steps = np.diff(raw)[follows]
    if len(steps) < LEAST_STEPS or not steps.any():
        return None
    first, last = int(raw.min()), int(raw.max())
    back = raw[1:][follows] < raw[:-1][follows]
    wraps = int(back.sum())
    modulus = (1 << bits) - first if wraps == 0 else last - first + 1
    if modulus < 3 and not (modulus == 2 and called_counter(name)):
        return None
    if wraps == 0 and (last - first < LEAST_STEPS or (not called_counter(name) and bits < 8)):
        return None
    if wraps == 0:
        first, modulus = 0, 1 << bits
    moved = np.mod(steps, modulus)
    ones = int((moved == 1).sum())
    losses = moved[(moved > 1) & (moved <= min(LONGEST_LOSS, modulus // 2))]
    if ones < (1 - LOST) * len(steps) or ones + len(losses) < len(steps) - max(1, LOST * len(steps) / 10):
        return None
    if len(np.unique(raw)) < min(modulus, len(steps)) * (0.5 if wraps == 0 else 0.99):
        return None
    return CounterFound(name, first, modulus, len(steps), ones, wraps, int((losses - 1).sum()))


def candidates(message: Message) -> list[Signal]:
    """Return the signals that may count, those first that are called so."""
    found = [
        signal
        for signal in message.signals
        if not signal.is_float
        and not signal.is_signed
        and 1 < signal.length <= MOST_BITS
        and not signal.multiplexer_ids
    ]
    return sorted(found, key=lambda signal: not called_counter(signal.name))
