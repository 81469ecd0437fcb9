"""Monitors that step once a sample: frames that the engine keeps until a sample is there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gateway.engine.tables import NEVER
from gateway.engine.timers import arm
from gateway.monitors import sampling, ticks
from gateway.monitors.contract import TIMER
from gateway.monitors.sampling import KEPT, MOST_MESSAGES, OVERTAKEN, SAMPLE, WAITS, Sampling, take, waited
from gateway_fdi.jit import Record, i4, kernel, means

#: Places of what a sample says of itself among the numbers of the inputs, as SampledInputs has them; waited of each
#: message.
_GAP, _MISSING, _WHICH, _WAITED = 2, 3, 4, 5


class Samples(sampling.State, lengths={"messages": MOST_MESSAGES}):
    """State of the samples of a monitor's messages."""


class SamplerPlace(Record):
    """How the frames of some messages of a monitor become samples."""

    const: sampling.Const = means("constants of the sampling")
    which: i4 = means("of the monitor's samplings it is")
    first: i4 = means("of its messages, of sampled[first : first + messages]")
    held: i4 = means("first of the cells that hold what has come of samples that are not there yet")
    cells: i4 = means("how many these are")


class SamplerState(Record):
    """State of one sampling."""

    samples: Samples = means("state of the sampling")


class Sampler(SamplerState, SamplerPlace):
    """One sampling of a monitor."""


class Sampled(Record):
    """A message of one."""

    row: i4 = means("of it in the vector table")
    counter: i4 = means("mailbox slot of its frame counter")
    sampler: i4 = means("whose message it is")
    message: i4 = means("its number there, from 0")
    first: i4 = means("carried[first : first + carries] are the inputs that it carries, by their numbers")
    carries: i4 = means("how many these are")


def fill(
    made: Any,
    asked: Sampling,
    carried: Mapping[int, Sequence[int]],
    counters: Mapping[int, int],
    *,
    which: int,
    nowhere: int,
    slots: int,
) -> None:
    """Append the rows of one sampling of a monitor.

    Args:
        made: has lists ``samplers``, ``sampled``, ``carried`` and the number of cells, ``held``.
        asked: for.
        carried: row of each message that makes a sample -> numbers of the inputs that it carries.
        counters: row of a message -> mailbox slot of its counter.
        which: of the monitor's samplings it is.
        nowhere: slot that stays NaN.
        slots: numbers of the monitor's inputs.
    """
    sampler = np.zeros(1, Sampler.dtype).view(np.recarray)[0]
    sampling.prepare(sampler.const, asked, len(carried))
    sampler.which, sampler.first, sampler.held = which, len(made.sampled), made.held
    sampler.cells = slots * (KEPT + 1 if sampler.const.lines else int(sampler.const.depth))
    for k, (message, mine) in enumerate(carried.items()):
        place = (message, counters.get(message, nowhere), len(made.samplers), k, len(made.carried), len(mine))
        made.sampled.append(place)
        made.carried += mine
    made.held += int(sampler.cells)
    made.samplers.append(sampler)


@kernel
def _whole(T: Any, t_ns: int, h: Any, y: Any) -> None:
    """Put a sample into the monitor's inputs: missing values are NaN, values of no message are the newest."""
    x, base = y.samples, y.held + y.samples.place * h.slots
    for n in range(h.first_loose, h.first_loose + h.loose):
        T.pool[h.cells + T.carried[n]] = T.mailbox[T.slots[h.first_slot + T.carried[n]]]
    if y.const.depth > 0 or y.const.lines == 1 or x.missing != 0:
        at = (x.at_ns // y.const.period_ns) & (KEPT - 1)
        for k in range(y.const.messages):
            m = T.sampled[y.first + k]
            for n in range(m.first, m.first + m.carries):
                cell = T.carried[n]
                if x.missing & (1 << k):
                    T.pool[h.cells + cell] = np.nan
                elif y.const.depth > 0:
                    T.pool[h.cells + cell] = T.held[base + cell]
                elif y.const.lines == 1:
                    T.pool[h.cells + cell] = T.held[y.held + cell * (KEPT + 1) + at]
    T.pool_ns[h.inputs] = x.at_ns
    T.pool[h.inputs + _GAP], T.pool[h.inputs + _MISSING], T.pool[h.inputs + _WHICH] = x.gap, x.missing, y.which
    for k in range(y.const.messages):
        T.pool[h.inputs + _WAITED + k] = waited(x, y.const, k, t_ns)


@kernel
def _take(T: Any, t_ns: int, h: Any, y: Any, m: Any) -> int:
    """Take a frame of a message; returns what it is."""
    x, c = y.samples, y.const
    if c.grid == 1:
        ticks.hear(x, c, t_ns)
    else:
        came = take(x, c, m.message, t_ns, T.mailbox[m.counter])
        if came == OVERTAKEN:
            return OVERTAKEN
    base = y.held + x.place * h.slots
    for n in range(m.first, m.first + m.carries):
        cell = T.carried[n]
        value = T.mailbox[T.slots[h.first_slot + cell]]
        if c.depth > 0:
            T.held[base + cell] = value
        elif c.lines == 1:
            ticks.draw(x, c, m.message, t_ns, T.held, y.held + cell * (KEPT + 1), value)
        else:
            T.pool[h.cells + cell] = value
    if c.lines == 1:
        ticks.drawn(x, c, m.message, t_ns)
        return int(ticks.between(x, c, t_ns))
    return int(ticks.hold(x, c, m.message, t_ns) if c.grid == 1 else came)


@kernel
def collect(T: Any, t_ns: int, trigger: int, h: Any, at: int) -> int:
    """Take a frame, or a tick, of a monitor that steps once a sample; its inputs have the sample, if one is there.

    Returns:
        where to look for the next one, ``h.sampled``: there is no other; -1: there is none.
    """
    for k in range(at, h.sampled):
        m = T.sampled[h.first_sampled + k]
        if m.row != trigger and (trigger != TIMER or m.message > 0):
            continue
        y = T.samplers[m.sampler]
        if trigger == TIMER:
            came = ticks.tick(y.samples, y.const, t_ns) if y.const.grid > y.const.lines else WAITS
        elif y.samples.more == 1:
            came = ticks.between(y.samples, y.const, t_ns)
        else:
            came = _take(T, t_ns, h, y, m)
        behind = h.sampled if h.samplings == 1 else k + 1
        if came == SAMPLE:
            _whole(T, t_ns, h, y)
            y.samples.more = y.const.lines
            return k if y.const.lines == 1 else behind
        y.samples.more = 0
        if behind == h.sampled:
            return -1
    return -1


@kernel
def wake_at_tick(T: Any, h: Any) -> None:
    """Have a monitor woken at the next tick of its clocks."""
    next_ns = NEVER
    for k in range(h.sampled):
        m = T.sampled[h.first_sampled + k]
        y = T.samplers[m.sampler]
        if m.message == 0 and y.const.grid > y.const.lines and y.samples.tick_ns > 0:
            next_ns = min(next_ns, y.samples.tick_ns)
    if next_ns != h.wake_ns:
        h.wake_ns = next_ns
        arm(T, h.timer, next_ns)
