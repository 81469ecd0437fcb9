"""Tooth frames (dbc/crank/crank.dbc) into intervals: which pulses a frame brings, and which were lost with others.

A frame that is lost on the bus is known by its counter: its pulses were there, unseen. In CTW_PT4 the
number of pulses of a lost frame is known only when it was full; CTW_BASE puts it right. CTW_FD27 tells its first
pulse's number.

An interval longer than ``stall_ms`` spans a standstill and tells nothing of the wheel; a shorter one is a tooth's,
however long: what it means is told by the speed before it.
"""

from __future__ import annotations

from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor import adaptive, noise, phase, sync_state
from gateway_plants.crank.monitor.faults import Reports
from gateway_plants.crank.monitor.records import CLASSIC_INTERVALS, Const, Inputs, State
from gateway_plants.crank.tooth_codec import OVERFLOW_CODE, PADDING_CODE, period_us


@kernel
def stand(s: State, c: Const, out: Reports) -> None:
    """The engine stands: synchronisation ends, and a burst of pulses that was not told yet is."""
    if s.fast.burst.count > 0:
        noise.tell(s.fast.burst, c.fast.firing_us, out)
    sync_state.stand(s.fast, c.fast)
    phase.forget(s.phase)


@kernel
def _lost(s: State, c: Const, number: int, out: Reports) -> None:
    """Pass over pulses whose times were lost on the bus."""
    s.count = (s.count + number) % 65536
    phase.restart(s.phase)
    adaptive.lost(s.fast, c.fast, number, s.guessed == 0, out)


@kernel
def wrapped(number: int) -> int:
    """Return a difference of two counters modulo 65536 as -32768..32767."""
    return (number + 32768) % 65536 - 32768


@kernel
def _forget_guess(s: State) -> None:
    """Forget a count that was guessed, where the gap has told the place since: it may have put a wrong guess right."""
    if s.guessed == 1 and s.fast.hole == 0:
        s.counted = 0


@kernel
def base(s: State, c: Const, u: Inputs) -> None:
    """Take CTW_BASE: the number of pulses sent, at the CTW_PT4 whose counter ends in ``valid``."""
    s.base_counter = int(u.base_counter)
    pulses, teeth = int(u.pulses), int(u.valid)
    if s.linked == 0:
        return
    if teeth != s.counter % 16:
        s.owed = 1
        s.owed_pulses = pulses
        s.owed_teeth = teeth
        return
    _forget_guess(s)
    if s.counted == 1:
        adaptive.recount(s.fast, c.fast, wrapped(pulses - s.count))
    s.count = pulses
    s.counted = 1
    s.guessed = 0
    s.owed = 0


@kernel
def _missing(s: State, frames: int, counter: int) -> int:
    """Return the pulses of lost CTW_PT4 frames: four each, or what CTW_BASE told meanwhile."""
    number = frames * CLASSIC_INTERVALS
    _forget_guess(s)
    s.guessed = 1
    if s.owed == 1:
        later = (counter - 1 - s.owed_teeth) % 16
        if s.counted == 1 and later < frames:
            told = s.owed_pulses + later * CLASSIC_INTERVALS - s.count
            number = max(wrapped(told), 0)
            s.guessed = 1 if later > 0 else 0
        s.count = (s.owed_pulses + later * CLASSIC_INTERVALS - number) % 65536
        s.counted = 1
        s.owed = 0
    return int(number)


@kernel
def _tooth(s: State, c: Const, y: float, out: Reports) -> None:
    """Take one interval [us]; none is taken over a standstill."""
    if y * 1e3 >= c.stall_ns:
        s.count = (s.count + 1) % 65536
        stand(s, c, out)
        return
    s.count = (s.count + 1) % 65536
    adaptive.tooth(s.fast, c.fast, y, out)


@kernel
def _teeth(s: State, c: Const, number: int, out: Reports) -> None:
    """Take the first intervals of the frame at hand."""
    k = 0
    while k < number:
        taken = adaptive.regular(s.fast, c.fast, s.intervals, k, number)
        s.count = (s.count + taken) % 65536
        k += taken
        if k < number:
            _tooth(s, c, s.intervals[k], out)
            k += 1


@kernel
def _stray(s: State, number: int, following: int) -> bool:
    """Tell whether a frame from the past came late; two that follow each other are a sender that restarted.

    Args:
        s: record of State.
        number: of the frame in the sender's count.
        following: number of the frame after it.
    """
    restarted = s.stray == number
    s.stray = -1 if restarted else following
    return bool(not restarted)


@kernel
def classic(s: State, c: Const, u: Inputs, out: Reports) -> bool:
    """Take a CTW_PT4; returns whether it brought pulses, which one from the past does not."""
    counter = int(u.counter)
    if s.linked == 1:
        frames = (counter - s.counter - 1) % 256
        if frames >= 128 and _stray(s, counter, (counter + 1) % 256):
            return False
        if frames >= 128:
            stand(s, c, out)
            s.counted = 0
            s.owed = 0
            s.base_counter = -1
        elif frames > 0:
            number = _missing(s, frames, counter)
            if number > 0:
                _lost(s, c, number, out)
    s.linked = 1
    s.counter = counter
    number = 0
    for k in range(CLASSIC_INTERVALS):
        code = int(u.intervals[k])
        if code == PADDING_CODE:
            continue
        if code == OVERFLOW_CODE:
            _teeth(s, c, number, out)
            number = 0
            s.count = (s.count + 1) % 65536
            stand(s, c, out)
            continue
        s.stalls_ns = u.t_ns + c.stall_ns
        s.intervals[number] = period_us(code)
        number += 1
    _teeth(s, c, number, out)
    return True


@kernel
def fd(s: State, c: Const, u: Inputs, out: Reports) -> bool:
    """Take a CTW_FD27, which tells its first pulse's number; returns as :func:`classic`."""
    pulses = int(u.pulses)
    if s.linked == 1:
        number = wrapped(pulses - s.count)
        if number < 0 and _stray(s, pulses, (pulses + int(u.valid)) % 65536):
            return False
        if number < 0:
            stand(s, c, out)
        elif number > 0:
            _lost(s, c, number, out)
    s.linked = 1
    s.count = pulses
    s.counted = 1
    scale = float(1 << int(u.shift))
    for k in range(int(u.valid)):
        s.stalls_ns = u.t_ns + c.stall_ns
        s.intervals[k] = u.intervals[k] * scale
    _teeth(s, c, int(u.valid), out)
    return True
