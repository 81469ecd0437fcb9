"""Alive counters, by what signals do: one up a frame, modulo a number that is learned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.signals.protection.params import COUNTERS

#: Chance explains a claim with a probability below one in 10^9: bits of evidence beyond those free to be chosen.
LEAST_EVIDENCE = float(9.0 / np.log10(2.0))
#: Longest counter that is looked for [bit].
MOST_BITS = 32
#: Largest loss that explains a step [frames]; it must agree with the time that passed to this number of cycles.
LONGEST_LOSS, CYCLES_OFF = 8, 1.2
#: Share of the steps that may be losses, where the time between frames says nothing of them and where it does.
LOST, LOST_TIMED = 0.1, 0.4
#: Share of the steps that nothing explains, at most; each speaks against it [bit].
UNEXPLAINED, AGAINST = 0.002, 10.0
#: How often it must come round for a number of values that is not all of its bits; a loss may hide the highest.
WRAPS = 3
#: Losses that would have to hide its highest values each time it came round are rarer than this: it has fewer values.
HIDDEN = 0.1
#: Values that one must show that never came round: it is called a counter then.
LEAST_VALUES = 32
#: A row of losses that is rarer is no matter: three such steps, one soon after the other, make a fault.
RARE = 1e-4
#: A field in these units counts time or way: it does not go up by one with each frame for ever.
QUANTITIES = frozenset({"s", "sec", "ms", "min", "h", "d", "km", "m", "mi", "l"})


@dataclass(frozen=True)
class CounterFound:
    """A counter.

    Attributes:
        signal: its name.
        first: the lowest of its values.
        modulus: how many it has.
        steps: that were looked at.
        ones: of these, those by one.
        wraps: how often it came round; 0: its values after its highest bits are set are not known, all are assumed.
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
        share = self.lost / max(self.steps + self.lost, 1)
        if self.lost:  # frames that get lost are no fault of the sender
            step = 1 + int(np.ceil(np.log(RARE) / np.log(min(share, 0.5))))
            keys["max_step"] = max(1, min(step, self.modulus - 2))
            if keys["max_step"] == 1:
                del keys["max_step"]
        return keys


def signal_of(message: Message, counter: CounterFound) -> Signal:
    """Return the signal that counts."""
    return next(signal for signal in message.signals if signal.name == counter.signal)


def called_counter(name: str) -> bool:
    """Return whether a signal is called as counters are."""
    return name.upper().rstrip("0123456789_").endswith(COUNTERS)


def of_raw(
    name: str,
    raw: NDArray[np.int64],
    follows: NDArray[np.bool_],
    bits: int,
    cycles: NDArray[np.float64] | None = None,
    hypotheses: int = 1,
) -> CounterFound | None:
    """Return whether a field counts: each frame one more, but for frames that were lost.

    Chance is a permutation: the same values in any order, so that a value that comes often follows any other often.
    The claim is less probable than one in 10^9 by it, for each of the fields that are looked at.

    Args:
        name: of the signal.
        raw: its values, frame by frame.
        follows: shape (frames - 1,), whether nothing lies between a frame and the next.
        bits: its length.
        cycles: shape (frames - 1,), time between a frame and the next, in cycles of the message; None: it has none.
        hypotheses: how many fields are looked at.

    Returns:
        None: it does not, or not surely.
    """
    if cycles is not None:
        follows = follows & (cycles < LONGEST_LOSS + 0.5)
    before, after = raw[:-1][follows], raw[1:][follows]
    if not len(before) or (before == after).all():
        return None
    wraps = int((after < before).sum())
    first, last = int(raw.min()), int(raw.max())
    choices = [(0, 1 << bits)]
    if wraps >= WRAPS and last - first + 1 < 1 << bits:
        choices.insert(0, (first, last - first + 1))
    if wraps == 0 and not (called_counter(name) and last - first >= LEAST_VALUES):
        return None
    time = None if cycles is None else cycles[follows]
    for first_, modulus in choices:
        found = _counts(name, (before, after), time, (first_, modulus), wraps)
        if found is not None and found[1] - np.log2(max(hypotheses, 1)) >= LEAST_EVIDENCE:
            return found[0]
    return None


def _counts(
    name: str,
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]],
    time: NDArray[np.float64] | None,
    values: tuple[int, int],
    wraps: int,
) -> tuple[CounterFound, float] | None:
    """Return a counter of these values (first, how many), and how much more than chance the pairs say for it [bit]."""
    before, after = pairs
    first, modulus = values
    if modulus < 3 and not (modulus == 2 and called_counter(name)):
        return None
    steps = np.mod(after - before, modulus)
    one = steps == 1 % modulus
    loss = np.zeros(len(steps), np.int64)
    for k in range(2, min(LONGEST_LOSS, modulus - 1 if time is None else LONGEST_LOSS) + 1):
        fits = (steps == k % modulus) & ~one & (loss == 0)
        loss[fits if time is None else fits & (np.abs(time - k) <= CYCLES_OFF)] = k - 1
    explained = one | (loss > 0)
    most = LOST if time is None else LOST_TIMED
    bad = int((~explained).sum())
    if bad > max(1.0, UNEXPLAINED * len(steps)) or (loss > 0).sum() > max(most * len(steps), 1.0):
        return None
    if _always(before, loss > 0):
        return None
    hidden = first + modulus - 1 - max(int(before.max()), int(after.max()))
    if hidden and wraps and ((loss > 0).mean() ** (hidden * wraps)) < HIDDEN:
        return None
    seen, counts = np.unique(after, return_counts=True)
    if len(seen) < min(modulus, len(steps)) * (0.5 if wraps == 0 else 0.9):
        return None
    often = counts[np.searchsorted(seen, after)] / len(after)
    # A loss is one of three steps that the time agrees with.
    bits = -np.log2(often[one]).sum() - np.log2(np.minimum(3.0 * often[loss > 0], 1.0)).sum() - AGAINST * bad
    return CounterFound(name, first, modulus, len(steps), int(one.sum()), wraps, int(loss.sum())), float(bits)


def _always(before: NDArray[np.int64], lost: NDArray[np.bool_]) -> bool:
    """Return whether what seem to be losses come nearly always after one value: then that is how the field goes on."""
    values, places = np.unique(before, return_inverse=True)
    count = np.bincount(places, minlength=len(values))
    losses = np.bincount(places, weights=lost, minlength=len(values))
    return bool(((count >= 2) & (losses > 0.7 * count)).any())


def candidates(message: Message) -> list[Signal]:
    """Return the signals that may count, those first that are called so."""
    found = [
        signal
        for signal in message.signals
        if not signal.is_float
        and not signal.is_signed
        and 1 < signal.length <= MOST_BITS
        and not signal.multiplexer_ids
        and (called_counter(signal.name) or (signal.unit or "").lower() not in QUANTITIES)
    ]
    return sorted(found, key=lambda signal: not called_counter(signal.name))


def likelier(found: CounterFound, bits: int) -> tuple[bool, bool, bool]:
    """Return what to sort counters by, the likeliest first: its name; that it begins at 0; that it has all values.

    The sum of a counter and constants goes up with it.
    """
    return not called_counter(found.signal), found.first != 0, found.modulus != 1 << bits
