"""From what the voter made of a sample to test results."""

from __future__ import annotations

from gateway.monitors.contract import Out, report
from gateway_fdi.jit import kernel
from gateway_plants.pedal.monitor.faults import (
    CORRELATION,
    DRIFT,
    DRIFTS,
    ERRATIC,
    HIGH,
    IMPLAUSIBLE,
    INVALID,
    JUMP,
    LOW,
    MISSING,
    PER_CHANNEL,
    RANGE,
    STUCK,
    Evidence,
)
from gateway_plants.pedal.monitor.records import Const, Outputs, State
from gateway_plants.pedal.voting.simple import MOST_CHANNELS
from gateway_plants.pedal.voting.supply import RIGHT
from gateway_plants.pedal.voting.tracking import isolation
from gateway_plants.pedal.voting.tracking.shape import (
    AGREED,
    COMMON_MODE,
    DRIFTED,
    FROZEN,
    ISOLATE,
    MOVED,
    NONE,
    TRUSTED,
)
from gateway_plants.pedal.voting.tracking.shape import (
    IMPLAUSIBLE as REJECTED,
)

#: How a reading lies to its range.
FINE, BELOW, ABOVE, OUTSIDE, ABSENT = range(5)
#: Shares of samples, averaged over so many: those in which a channel goes wrong; those without agreement.
ERRATIC_OVER, SPLIT_OVER = 256.0, 64.0
#: From which share on they fail, and below which they pass; in between the verdict stands.
ERRATIC_FAILS, ERRATIC_PASSES = 0.05, 0.02
SPLIT_FAILS, SPLIT_PASSES = 0.5, 0.1
#: Samples of a channel that is there after which every debounce has healed: it need not be told any more.
HEALS = 1 << 15
#: Channels that agreed hardly ever before have not jumped together.
SPLIT_JUMP = 0.3


@kernel
def _of_channel(
    s: State,
    i: int,
    fault: int,
    failed: bool,
    value: float,
    limit: float,
    out: Out[Evidence, Outputs],
) -> None:
    """Report a test of channel ``i`` with its evidence; ``fault`` is its place among all."""
    e = report(out, fault, failed, value, limit).channel
    if not failed:
        return
    v = s.tracking
    e.voted = s.value
    if s.place[i] == ABSENT:
        return
    e.reading = s.reading[i]
    e.position = s.position[i]
    # A reading outside its range has not been seen by the voter.
    e.innovation = v.innovation[i] if s.place[i] == FINE else s.position[i] - s.value
    e.gate = v.gate
    e.mismatch = v.mismatch.level[i]
    e.rejected = v.rejected[i]
    e.repeated = v.habits.same[i]


@kernel
def _of_all(
    s: State,
    c: Const,
    fault: int,
    failed: bool,
    value: float,
    limit: float,
    out: Out[Evidence, Outputs],
) -> None:
    """Report a test of all channels with its evidence."""
    e = report(out, c.channels * PER_CHANNEL + fault, failed, value, limit).common
    if not failed:
        return
    for i in range(c.channels):
        e.channel[i] = 0.0 if s.place[i] == ABSENT else s.position[i]
    e.voted = s.value
    e.speed = s.speed
    e.mismatch = s.tracking.spread
    e.split = s.diagnosis.split


@kernel
def _channel(s: State, c: Const, i: int, out: Out[Evidence, Outputs]) -> None:
    """Test one channel."""
    v, d, place = s.tracking, s.diagnosis, s.place[i]
    first = i * PER_CHANNEL
    d.absent[i] = d.absent[i] + 1 if place == ABSENT else 0
    d.there[i] = d.there[i] + 1 if place != ABSENT else 0
    if d.there[i] <= HEALS:
        _of_channel(s, i, first + MISSING, place == ABSENT, d.absent[i], 0.0, out)
    if place == ABSENT:
        return
    _of_channel(s, i, first + LOW, place == BELOW, s.reading[i], c.low[i], out)
    _of_channel(s, i, first + HIGH, place == ABOVE, s.reading[i], c.high[i], out)
    if place in (FINE, OUTSIDE):
        _of_channel(s, i, first + RANGE, place == OUTSIDE, s.position[i], 100.0 + c.over, out)
    if place != FINE:
        return  # its place is the cause; the voter has not seen it
    judged = s.sensors.known == 1  # by the noise there is
    why = v.why[i] if v.isolated & (1 << i) else TRUSTED
    if why in (TRUSTED, FROZEN):
        repeated, silent = v.habits.same[i], v.scale.silent
        _of_channel(s, i, first + STUCK, why == FROZEN, repeated, silent, out)
    if why in (TRUSTED, REJECTED):
        _of_channel(s, i, first + IMPLAUSIBLE, judged and why == REJECTED, v.rejected[i], ISOLATE, out)
    if why in (TRUSTED, DRIFTED) and c.channels == MOST_CHANNELS:
        drifts = c.channels * PER_CHANNEL + DRIFTS + i
        moved, tolerance = abs(v.mismatch.level[i]), c.tracking.tolerance
        _of_channel(s, i, drifts, judged and why == DRIFTED, moved, tolerance, out)
    if why != TRUSTED:
        d.erratic[i] = 0.0
        return
    if v.used != 0:
        _erratic(s, c, i, judged, out)


@kernel
def _erratic(s: State, c: Const, i: int, judged: bool, out: Out[Evidence, Outputs]) -> None:
    """Test how often a trusted channel goes wrong, or jumps; ``judged``: the noise of the channels is known."""
    v, d = s.tracking, s.diagnosis
    noisy = 1.0 if judged else 0.0
    for j in range(c.channels):
        if j != i and 2.0 * v.habits.shaken[j] > v.habits.shaken[i]:
            noisy = 0.0  # what all do is no fault of one
    wrong = judged and v.used & (1 << i) == 0 and abs(v.innovation[i]) > v.gate + v.slack
    if wrong:
        trusted = 0
        for j in range(c.channels):
            if s.place[j] == FINE and v.isolated & (1 << j) == 0:
                trusted |= 1 << j
        wrong = isolation.witnessed(v, c.tracking, trusted, i)
    # A channel that goes wrong and stays so is not erratic: what counts is how often it begins.
    began = wrong and d.wrong[i] == 0
    d.wrong[i] = 1 if wrong else 0
    d.erratic[i] += ((1.0 if began else 0.0) - d.erratic[i]) / ERRATIC_OVER
    share = max(d.erratic[i], noisy * v.habits.shaken[i])
    if share > ERRATIC_FAILS or share < ERRATIC_PASSES:
        failed = share > ERRATIC_FAILS
        often, limit = 100.0 * share, 100.0 * ERRATIC_FAILS
        _of_channel(s, i, i * PER_CHANNEL + ERRATIC, failed, often, limit, out)


@kernel
def _of_supply(s: State, c: Const, out: Out[Evidence, Outputs]) -> None:
    """Report the test of the common supply with its evidence."""
    failed = s.supply.active == 1
    e = report(out, c.last_fault, failed, abs(s.share - 1.0), RIGHT).supply
    if not failed:
        return
    for i in range(c.channels):
        e.reading[i] = s.reading[i]
    e.voted, e.share = s.value, 100.0 * s.share


@kernel
def diagnose(s: State, c: Const, out: Out[Evidence, Outputs]) -> None:
    """Report what a sample shows.

    Args:
        s: the monitor's state.
    """
    v, d = s.tracking, s.diagnosis
    valid = 0
    for i in range(c.channels):
        _channel(s, c, i, out)
        if s.place[i] == FINE and v.isolated & (1 << i) == 0:
            valid += 1
    if valid >= 2:
        agreed = v.source in (AGREED, MOVED)
        judged = s.sensors.known == 1
        d.split += ((0.0 if agreed or not judged else 1.0) - d.split) / SPLIT_OVER
        if d.split > SPLIT_FAILS or d.split < SPLIT_PASSES:
            _of_all(s, c, CORRELATION, d.split > SPLIT_FAILS, d.split, SPLIT_FAILS, out)
        if v.slow_limit > 0.0:  # the voter has looked at it
            _of_all(s, c, DRIFT, judged and v.drift == 1, v.spread, v.slow_limit, out)
    # A sample of another time, there and back, is no jump: it has to be farther than the quantity moves meanwhile.
    jumped = v.source == COMMON_MODE and d.split < SPLIT_JUMP
    for i in range(c.channels):
        near = abs(v.innovation[i]) <= c.tracking.slew * v.motion.coasted
        jumped = jumped and not (near and s.place[i] == FINE and v.isolated & (1 << i) == 0)
    _of_all(s, c, JUMP, jumped, v.common, 1.0, out)
    if c.supply.possible == 1:
        _of_supply(s, c, out)
    if v.source == NONE or v.used:
        _of_all(s, c, INVALID, v.source == NONE, v.motion.coasted, c.lost, out)
