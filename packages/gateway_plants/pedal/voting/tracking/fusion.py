"""Which readings are believed in a sample: those that agree, else what the track says."""

from __future__ import annotations

import numpy as np

from gateway_fdi.jit import f8s, kernel
from gateway_plants.pedal.voting.simple import MOST_CHANNELS, middle
from gateway_plants.pedal.voting.tracking import channel_activity, mismatch, motion, track
from gateway_plants.pedal.voting.tracking.scale import GATE
from gateway_plants.pedal.voting.tracking.shape import (
    AGREED,
    CALM,
    COASTED,
    COMMON,
    COMMON_AT_END,
    COMMON_MODE,
    DOUBT,
    ISOLATE,
    LONG,
    MOVED,
    SINGLE,
    SURE,
    SUREST,
    SUSPECT,
    Const,
    State,
)


@kernel
def _together(s: State, c: Const, bits: int, count: int, near: bool, dt: float) -> None:
    """Readings that agree: the track, a change of slope, or all wrong together."""
    m = s.motion
    z = 0.0
    for i in range(c.channels):
        if bits & (1 << i):
            z += s.z[i]
    z /= count
    innovation = z - m.x
    if abs(innovation) <= GATE * np.sqrt(m.p00 + s.scale.variance / count):
        motion.correct(m, innovation, s.scale.variance / count)
        track.accept(s, c, bits, AGREED)
        s.sure = min(s.sure + 1, SUREST)
        s.met = 1
        s.old_age = 0
        lagging = s.slack >= s.scale.agree
        for i in range(c.channels):
            if bits & (1 << i) and near:
                channel_activity.agreed(s.habits, i)
                mismatch.learn(s.mismatch, i, s.z[i] - z, dt, lagging)
        return
    reach = c.slew * (m.coasted - s.common + dt)
    at_end = min(z - c.floor, c.ceiling - z) <= s.scale.agree
    s.common += 1
    smooth, sound, source = True, True, COMMON_MODE
    for i in range(c.channels):
        if bits & (1 << i):
            if s.habits.line[i] >= 1:
                source = COASTED  # it has not jumped: it is the track that was lost
            smooth = smooth and s.habits.line[i] >= 1
            sound = sound and s.rejected[i] < DOUBT
    known = abs(z - s.anchor) <= reach and (sound or smooth)
    if at_end:
        believed = s.common >= COMMON_AT_END
    else:
        believed = s.common >= COMMON or smooth or (sound and s.sure < SURE)
    if known or believed:
        track.remember(s)
        if known:
            track.turn(s, c, z, count, dt)
        else:
            motion.restart(m, z, 0.0, s.scale.variance / count, c.slew * c.slew / 9.0)
        track.accept(s, c, bits, MOVED)
        s.sure = 1
        return
    track.coast(s, dt, source)


@kernel
def _smooth(s: State, c: Const, trusted: int, alone: bool, dt: float) -> int:
    """Return the channel whose line goes on from where the track was lost; -1: none.

    A foot changes its speed, not its place: a line that does not lead back to the last sure level is an offset. It is
    followed only after long coasting, when nothing better has come, or where there is no other channel; so is a
    channel that was rejected more often than another.
    """
    m, h = s.motion, s.habits
    if m.coasted < 2.0:
        return -1
    late = m.coasted >= SUSPECT
    calmest = 2 * ISOLATE + 1
    if not alone and not late:
        for i in range(c.channels):
            if trusted & (1 << i):
                calmest = min(calmest, s.rejected[i] + 2)
    elapsed = m.coasted + dt
    best, nearest = -1, np.inf
    for i in range(c.channels):
        if trusted & (1 << i) == 0 or h.line[i] < 1 or s.rejected[i] >= calmest:
            continue
        v = channel_activity.slope(h, i)
        miss = abs(s.z[i] - v * elapsed - s.anchor)
        reachable = abs(s.z[i] - s.anchor) <= c.slew * elapsed
        if reachable and miss < nearest and (late or alone or miss <= 1.5 * abs(v) * dt + s.scale.agree):
            best, nearest = i, miss
    return best


@kernel
def _sound(s: State, c: Const, trusted: int) -> bool:
    """Tell whether there is a channel that was hardly ever rejected, and the track is not lost for long.

    Then one that was rejected often, and meets the coasting track by chance, is not believed.
    """
    found = False
    for i in range(c.channels):
        if trusted & (1 << i):
            found = found or s.rejected[i] < DOUBT
    return found and s.motion.coasted < SUSPECT


@kernel
def _apart(s: State, c: Const, y: f8s, trusted: int, alone: bool, dt: float) -> None:
    """Readings that disagree, or one alone: the one the track expects, or a smooth one, or none."""
    m = s.motion
    best = track.regret(s, c, trusted)
    if best >= 0:
        motion.copy(m, s.old)
        s.old_age = 0
        track.expect(s, c, y)
        s.gate = GATE * np.sqrt(m.p00 + s.scale.variance)
    nearest = s.gate
    sound = _sound(s, c, trusted)
    for i in range(c.channels):
        if trusted & (1 << i) and abs(s.innovation[i]) <= nearest:
            if sound and s.rejected[i] >= DOUBT:
                continue
            best, nearest = i, abs(s.innovation[i])
    if best >= 0:
        motion.correct(m, s.innovation[best], s.scale.variance)
        track.accept(s, c, 1 << best, SINGLE)
        s.sure = max(s.sure - 1, 0)
        return
    best = _smooth(s, c, trusted, alone, dt)
    if best >= 0:
        track.follow(s, c, best)
        return
    source = COASTED
    for i in range(c.channels):
        far = abs(s.z[i] - s.anchor) > c.slew * (m.coasted + dt) + s.scale.agree
        if s.alone > ISOLATE and trusted & (1 << i) and far:
            source = COMMON_MODE  # all that is left jumps, farther than a foot moves
            s.common += 1
    track.coast(s, dt, source)


@kernel
def _creeping(s: State, c: Const, trusted: int, parity: float, dt: float) -> bool:
    """Tell whether what two channels differ by is a mismatch, and no fault of one of them.

    It is when they parted without a jump, this sample and the one before; or when both go a smooth way, and what
    they differ by has changed little, or has been there from the start: nobody can tell then which one is off.
    """
    if (
        0.0 < s.apart <= CALM
        and abs(parity - s.lately) <= c.creep * dt + s.scale.noise_gate
        and abs(s.lately - s.parity) <= c.creep * s.apart + s.scale.noise_gate
    ):
        return True
    step = min(abs(parity - s.parity), abs(parity))
    if (
        s.apart < 2.0
        or abs(parity - s.lately) > c.creep * dt + s.scale.noise_gate
        or (s.met == 1 and step > (2.0 * c.tolerance if s.drift else c.tolerance / 2.0))
    ):
        return False
    smooth = True
    for i in range(c.channels):
        if trusted & (1 << i):
            smooth = smooth and s.habits.line[i] >= 2
    return smooth


@kernel
def _parity(y: f8s, n: int, trusted: int) -> float:
    """Return the reading of the later one of two trusted channels less that of the earlier one."""
    parity = 0.0
    for i in range(n):
        if trusted & (1 << i):
            parity = y[i] - parity
    return parity


@kernel
def decide(s: State, c: Const, y: f8s, trusted: int, dt: float) -> None:
    """Believe those that agree; where there is no agreement, what the track says."""
    n, z = c.channels, s.z
    count, total = 0, 0.0
    for i in range(n):
        if trusted & (1 << i):
            count += 1
            total += z[i]
    s.alone = s.alone + 1 if count == 1 else 0
    if count == 0:
        track.coast(s, dt, COASTED)
        return
    centre = middle(z, n) if count == MOST_CHANNELS else total / count
    # Two are as far from each other as twice from their mean.
    reach, slack = s.scale.agree + c.mismatch * abs(s.motion.v) * dt, s.slack
    if count < MOST_CHANNELS:
        reach /= 2.0
        slack /= 2.0
    members, bits, near = 0, 0, True
    for i in range(n):
        if trusted & (1 << i) and abs(z[i] - centre) <= reach + slack:
            bits |= 1 << i
            members += 1
            near = near and abs(z[i] - centre) <= reach
    if count == 2:
        parity = _parity(y, n, trusted)
        if trusted != s.pair:
            s.pair = trusted
            s.apart = LONG
        if members < 2 and _creeping(s, c, trusted, parity, dt):
            for i in range(n):
                if trusted & (1 << i):
                    s.mismatch.level[i] += z[i] - centre
                    z[i] = centre
            bits, members = trusted, 2
        # What a lag is allowed is an agreement to go on from only if they parted without a jump.
        steady = s.apart == 0.0 and abs(parity - s.lately) <= c.creep * dt + s.scale.noise_gate
        if members == 2 and (near or steady):
            s.parity = parity
            s.apart = 0.0
        else:
            s.apart += dt
        s.lately = parity
    if members >= 2:
        _together(s, c, bits, members, near, dt)
    else:
        _apart(s, c, y, trusted, count == 1, dt)
