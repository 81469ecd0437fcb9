"""Monitors that step once a sample: what the engine keeps of their frames until one is there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from gateway.jit import Record, i4, kernel, means
from gateway.monitors import sampling
from gateway.monitors.sampling import MOST_MESSAGES, SAMPLE, Sampling, take, waited

#: Places of what a sample says of itself among the numbers of the inputs: gap, missing, waited of each message.
_GAP, _MISSING, _WAITED = 2, 3, 4


class Samples(sampling.State, lengths={"messages": MOST_MESSAGES}):
    """What has come of the messages of a monitor."""


class SamplerPlace(Record):
    """How the frames of a monitor become samples."""

    const: sampling.Const
    first: i4 = means("of its messages, of sampled[first : first + messages]")
    held: i4 = means("first of the cells that hold what has come of sets")


class SamplerState(Record):
    """What has come."""

    samples: Samples


class Sampler(SamplerState, SamplerPlace):
    """One monitor that steps once a sample."""


class Sampled(Record):
    """A message of such a monitor."""

    row: i4 = means("of it in the vector table")
    counter: i4 = means("mailbox slot of its frame counter")


class Needed(NamedTuple):
    """The tables that it needs: handing down all of them costs more than what is done with them."""

    samplers: Any
    sampled: Any
    slots: Any
    places: Any
    mailbox: Any
    held: Any
    pool: Any


def fill(
    row: Any, asked: Sampling, messages: Sequence[int], counters: Mapping[int, int], nowhere: int
) -> list[tuple[int, int]]:
    """Fill the row of a monitor; returns the rows of its messages.

    Args:
        row: of Sampler.
        asked: for.
        messages: rows of the messages that make a sample, in the order of the inputs.
        counters: row of a message -> mailbox slot of its counter.
        nowhere: slot that stays NaN.
    """
    sampling.prepare(row.const, asked, len(messages))
    return [(message, counters.get(message, nowhere)) for message in messages]


@kernel
def _whole(T: Any, t_ns: int, h: Any, y: Any) -> None:
    """Put a sample into the monitor's inputs: what is missing is NaN, what belongs to no message is the newest."""
    x, at, first, base = y.samples, h.cells, h.first_slot, y.held + y.samples.place * h.slots
    for k in range(h.slots):
        message = T.places[first + k]
        if message < 0:
            T.pool[at + k] = T.mailbox[T.slots[first + k]]
        elif x.missing & (1 << message):
            T.pool[at + k] = np.nan
        elif y.const.depth > 0:
            T.pool[at + k] = T.held[base + k]
    T.pool[h.inputs + _GAP] = x.gap
    T.pool[h.inputs + _MISSING] = x.missing
    for k in range(y.const.messages):
        T.pool[h.inputs + _WAITED + k] = waited(x, y.const, k, t_ns)


@kernel(inlined=False)
def _collect(T: Any, t_ns: int, trigger: int, h: Any) -> bool:
    y = T.samplers[h.sampler]
    message = -1
    for k in range(y.first, y.first + y.const.messages):
        if T.sampled[k].row == trigger:
            message = k - y.first
            break
    if message < 0:
        return False
    counter = T.mailbox[T.sampled[y.first + message].counter]
    sets = y.const.depth > 0
    came = take(y.samples, y.const, message, t_ns, counter)
    if came == sampling.OVERTAKEN:
        return False
    first, base = h.first_slot, y.held + y.samples.place * h.slots
    for k in range(h.slots):
        if T.places[first + k] == message:
            value = T.mailbox[T.slots[first + k]]
            if sets:
                T.held[base + k] = value
            else:
                T.pool[h.cells + k] = value
    if came != SAMPLE:
        return False
    _whole(T, t_ns, h, y)
    return True


@kernel
def collect(T: Any, t_ns: int, trigger: int, h: Any) -> bool:
    """Take a frame of a monitor that steps once a sample; returns whether one is there, and in its inputs."""
    needed = Needed(T.samplers, T.sampled, T.slots, T.places, T.mailbox, T.held, T.pool)
    return bool(_collect(needed, t_ns, trigger, h))
