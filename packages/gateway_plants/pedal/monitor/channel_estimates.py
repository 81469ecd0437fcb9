"""What healthy logs say of the channels: their noise and resolution, lag, offsets, slopes (``gateway calibrate``).

Estimators, blocks, deviations: :mod:`gateway_plants.pedal.voting.identification.survey`. Which of two channels is off
nobody can tell: offsets and slopes are told against the mean of all, and become the mismatch that is usual. At run time
the noise and the lag are learned from each drive again; what is set here is where that begins, and how far it may go.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.monitors.contract import Measured
from gateway_fdi.errors import InputError
from gateway_plants.pedal.monitor.params import BEND, Params
from gateway_plants.pedal.voting.identification.survey import LEAST_SAMPLES, MOST_LAG_MS, Estimate, Survey, survey

#: Blocks that logs must have, and those of them in which the pedal moves enough to tell the lag.
BLOCKS, MOVED = 3, 3
#: Share of the travel over which it must have rested, or moved slowly [%].
TRAVEL = 30.0
#: Largest difference of the channels, and of their slopes, that is one of healthy sensors [%].
APART = 25.0
#: Share of the readings beyond their range that is not healthy.
OUTSIDE = 1e-3
#: Margin of what is usual over what was found, in times and in standard deviations; least values [%], [ms], [%].
TIMES, DEVIATIONS = 1.5, 3.0
LEAST_TOLERANCE, LEAST_LAG, LEAST_GAIN = 1.0, 1.5, 0.2
#: Standard deviations of a reading that the voter's mismatch, which follows a drift within tens of samples, moves by.
OF_NOISE = 6.0

Array = NDArray[np.float64]


def _positions(p: Params, records: Sequence[Array]) -> list[Array]:
    """Return readings as per cent of the travel; those beyond the range end a record, lost ones (NaN) do not."""
    low = np.array([channel.low for channel in p.channels])
    high = np.array([channel.high for channel in p.channels])
    rest = np.array([channel.at_rest for channel in p.channels])
    percent = np.array([channel.percent for channel in p.channels])
    found, total, wrong = [], 0, np.zeros(len(p.channels))
    for record in records:
        lost = np.isnan(record)
        fine = lost | ((record >= low) & (record <= high))
        total += int(np.count_nonzero(~lost.any(axis=1)))
        wrong += (~fine).sum(axis=0)
        cuts = np.flatnonzero(~fine.all(axis=1))
        found += [part[1:] if k else part for k, part in enumerate(np.split((record - rest) * percent, cuts))]
    worst = int(np.argmax(wrong))
    if total and wrong[worst] > OUTSIDE * total:
        raise InputError(
            f"{100 * wrong[worst] / total:.2g} % of its readings lie beyond low and high: these logs are not healthy",
            key=f"channel[{worst}]",
            value=p.channels[worst].signal,
        )
    return found


def _refuse(p: Params, s: Survey) -> None:
    """Raise what the logs lack."""
    if s.blocks < BLOCKS:
        least = BLOCKS * max(20.0, LEAST_SAMPLES * p.period_ms * 1e-3)
        raise InputError(
            f"the logs hold {s.blocks} stretches that are long enough and not full of gaps; {BLOCKS} are needed, "
            f"{least:.0f} s of readings each {p.period_ms:g} ms",
            key="period_ms",
            value=p.period_ms,
        )
    if not s.offset or s.high - s.low < TRAVEL:
        raise InputError(
            f"the logs do not tell offsets and slopes: the pedal rests, or moves slowly, from {s.low:.0f} to "
            f"{s.high:.0f} % of its travel; over {TRAVEL:.0f} % at least is needed",
            key="tolerance",
        )
    apart = max(g.value for g in s.gain) - min(g.value for g in s.gain)
    if max(s.mismatch, 100.0 * apart) > APART:
        raise InputError(
            f"the channels differ by {s.mismatch:.0f} % of the travel, their slopes by {100.0 * apart:.0f} %: at_rest "
            "and at_full are not those of these sensors, or one of them is not healthy",
            key="channel",
        )
    if p.finds_lag and s.moved < MOVED:
        raise InputError(
            f"the logs do not tell the lag: in {s.moved} of {s.blocks} stretches the pedal moves up and down fast "
            f"enough, {MOVED} are needed",
            key="lag_ms",
        )


def _at_least(estimate: Estimate) -> float:
    """Return what is usual of a number that was found."""
    return TIMES * abs(estimate.value) + DEVIATIONS * (0.0 if estimate.sd == inf else estimate.sd)


def found(p: Params, records: Sequence[Array]) -> Measured:
    """Return what logs say.

    Args:
        p: parameters.
        records: readings in a row, shape (samples, channels), units of the signals; NaN: lost.

    Raises:
        InputError: the logs do not tell, or are not healthy.
    """
    told = max(abs(channel.noise * channel.percent) for channel in p.channels)
    step = max(abs(channel.resolution * channel.percent) for channel in p.channels)
    s = survey(
        _positions(p, records),
        period_ms=p.period_ms,
        told=told,
        step=step,
        span=100.0,
        bend=100.0 * BEND * p.period_ms**1.5,
    )
    _refuse(p, s)
    rows: list[tuple[str, float, float, float]] = []
    channels: list[dict[str, float]] = []
    for i, channel in enumerate(p.channels):
        name, unit = f"channel[{i}]", 1.0 / abs(channel.percent)
        noise, resolution = s.noise[i].value * unit, s.resolution[i] * unit
        rows.append((f"{name}.noise", channel.noise, noise, s.noise[i].sd * unit))
        rows.append((f"{name}.resolution", channel.resolution, resolution or nan, nan))
        rows.append((f"{name} offset at rest [%]", nan, s.offset[i].value, s.offset[i].sd))
        rows.append((f"{name} slope, error [%]", nan, 100.0 * s.gain[i].value, 100.0 * s.gain[i].sd))
        if p.finds_lag:
            rows.append((f"{name} lag [ms]", nan, s.lag_ms[i].value, s.lag_ms[i].sd))
        channels.append({"noise": noise, "resolution": resolution or channel.resolution})
    keys: dict[str, Any] = {"channel": channels}
    apart = max(g.value for g in s.gain) - min(g.value for g in s.gain)
    noisy = max(each.value for each in s.noise)
    keys["tolerance"] = max(TIMES * s.mismatch + OF_NOISE * noisy, LEAST_TOLERANCE)
    keys["gain_error"] = max(100.0 * _at_least(Estimate(apart, max(g.sd for g in s.gain))), LEAST_GAIN)
    rows += [(key, getattr(p, key), keys[key], nan) for key in ("tolerance", "gain_error")]
    if p.finds_lag:
        slowest = max(range(len(channels)), key=lambda i: s.lag_ms[i].value)
        if s.lag_ms[slowest].value > MOST_LAG_MS:
            raise InputError(
                f"it lags {s.lag_ms[slowest].value:.1f} ms behind another one; {MOST_LAG_MS:g} ms is the most that can "
                "be allowed",
                key="lag_ms",
                value=p.channels[slowest].signal,
            )
        keys["lag_ms"] = float(np.clip(_at_least(s.lag_ms[slowest]), LEAST_LAG, MOST_LAG_MS))
        rows.append(("lag_ms", p.lag_ms, keys["lag_ms"], nan))
    return Measured(keys, tuple(rows))
