"""Stopping rules: limits for a target of the mean time between false alarms, and the limits that the data support.

Each stopping rule keeps the largest level it has seen. Read once a second of recorded time, these maxima tell for any
threshold how many alarms there would have been: seconds beyond it that follow each other are one. If the logs are
longer than the target, the threshold is where the alarms are as rare as asked for. If they are not, the maxima's tail
is continued as an exponential (:mod:`gateway_fdi.tails`), and the result says by how much the target lies
beyond the data. The time that the data assure, with 95 %, is chi-square: T / 3.0 without an alarm in the time T.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.config.model import Config
from gateway.monitors.contract import Calibration
from gateway_calibration.logs import Reading, Replay, of_kind, parts, refuse
from gateway_calibration.part import Part, Parts, failed_in
from gateway_fdi.errors import InputError
from gateway_fdi.stopping import assured
from gateway_fdi.tails import exceeded_once

#: Time whose largest levels are kept together [ns], and left out at the begin of each log.
BLOCK_NS, WARM_UP_NS = 1_000_000_000, 2_000_000_000
#: A threshold is not below the largest healthy level times this.
MARGIN = 1.05

Array = NDArray[np.float64]


def alarms(maxima: Array, threshold: float) -> int:
    """Return how many alarms a threshold would have given; maxima beyond it that follow each other are one."""
    over = maxima >= threshold
    return int((over[1:] & ~over[:-1]).sum() + bool(len(over) and over[0]))


@dataclass(frozen=True)
class Proposal:
    """A threshold for one symptom.

    Attributes:
        monitor: name of the monitor.
        symptom: key in its ``thresholds``.
        now: threshold of the configuration.
        largest: level in the logs.
        threshold: proposed.
        alarms: that it would have given in the logs.
        alarms_now: that the present one would have.
        assured_s: mean time between its false alarms that the data assure.
        beyond: target over the length of the logs; above 1 the threshold is extrapolated.
    """

    monitor: str
    symptom: str
    now: float
    largest: float
    threshold: float
    alarms: int
    alarms_now: int
    assured_s: float
    beyond: float


def propose(maxima: Array, seconds: float, target: float) -> float:
    """Return the threshold of one symptom, 0 if it has never spoken.

    Args:
        maxima: largest level of each block, shape (blocks,).
        seconds: of the logs.
        target: mean time between false alarms asked for [s].
    """
    largest = float(maxima.max(initial=0.0))
    allowed = int(seconds / target)
    if allowed >= 1:
        for level in np.unique(maxima)[::-1]:
            if alarms(maxima, float(level)) > allowed:
                break
            best = float(level)
        return float(np.nextafter(best, np.inf)) if allowed > 1 else largest * MARGIN
    reached = exceeded_once(maxima, len(maxima) * target / seconds) if len(maxima) else 0.0
    return max(reached, largest * MARGIN)


@dataclass(frozen=True)
class Levels:
    """Effect of healthy logs on the stopping rules.

    Attributes:
        seconds: that count.
        maxima: monitor -> largest levels, shape (blocks, symptoms).
        failed: DTCs that the logs set.
    """

    seconds: float
    maxima: dict[str, Array]
    failed: tuple[str, ...]


def of_log(config: Config, log: Path, how: Reading) -> Part:
    """Replay a log with a gateway of its own; returns the largest levels of each second, shape (blocks, symptoms).

    Raises:
        InputError: the log cannot be read.
    """
    chosen = of_kind(config, Calibration)
    found: dict[str, list[Array]] = {each.name: [] for each in chosen}
    blocks = end_ns = 0
    with Replay(config, how) as replay:
        engine = replay.gateway.engine
        rules = [(c.name, c.calibration.rules(engine.state_of(engine.place_of(c.name))[0])) for c in chosen]
        for frames in replay.frames(log):
            warm_ns = replay.begun_ns + WARM_UP_NS
            end_ns = end_ns or warm_ns
            for part, ended in parts(frames, end_ns, BLOCK_NS):
                replay.gateway.feed(part)
                if not ended:
                    continue
                for name, states in rules:
                    if end_ns > warm_ns:
                        found[name].append(np.array(states["peak"]))
                    states["peak"] = 0.0
                blocks += end_ns > warm_ns
                end_ns += BLOCK_NS
    arrays = {c.name: np.reshape(np.array(found[c.name]), (blocks, len(c.calibration.names))) for c in chosen}
    return Part(blocks * BLOCK_NS * 1e-9, tuple(sorted(replay.failed)), arrays)


def merged(config: Config, said: Parts) -> Levels:
    """Put together what :func:`of_log` found, in the order of the logs.

    Raises:
        InputError: the logs are too short.
    """
    blocks = sum(round(part.seconds * 1e9 / BLOCK_NS) for part in said.values())
    if not blocks:
        raise InputError("the logs hold less than 3 s of traffic", file=next(iter(said), None))
    names = [each.name for each in of_kind(config, Calibration)]
    stacked = {name: np.concatenate([part.arrays[name] for part in said.values()]) for name in names}
    return Levels(blocks * BLOCK_NS * 1e-9, stacked, failed_in(said))


def levels(config: Config, logs: Sequence[Path], how: Reading) -> Levels:
    """Replay logs, each with a gateway of its own, and keep the largest levels of each second (:func:`of_log`).

    Raises:
        InputError: no monitor of the configuration can be calibrated, or a log cannot be read.
    """
    if not of_kind(config, Calibration):
        raise refuse("stopping rules", how.file)
    return merged(config, {log: of_log(config, log, how) for log in logs})


def calibrate(config: Config, seen: Levels, target: float) -> list[Proposal]:
    """Return a threshold for each symptom; the target is that of all of a monitor's symptoms together.

    Args:
        config: the configuration.
        seen: result of :func:`levels`.
        target: mean time between false alarms [s].
    """
    proposals = []
    for chosen in of_kind(config, Calibration):
        maxima = seen.maxima[chosen.name]
        each = target * len(chosen.calibration.names)
        now = chosen.calibration.levels(chosen.params)
        for j, (symptom, present) in enumerate(zip(chosen.calibration.names, now, strict=True)):
            # A symptom that has never spoken keeps its threshold.
            threshold = propose(maxima[:, j], seen.seconds, each) or present
            count = alarms(maxima[:, j], threshold)
            proposals.append(
                Proposal(
                    monitor=chosen.name,
                    symptom=symptom,
                    now=present,
                    largest=float(maxima[:, j].max()),
                    threshold=threshold,
                    alarms=count,
                    alarms_now=alarms(maxima[:, j], present),
                    assured_s=assured(seen.seconds, count),
                    beyond=each / seen.seconds,
                )
            )
    return proposals


def tables(proposals: Sequence[Proposal]) -> dict[str, dict[str, dict[str, float]]]:
    """Return what a configuration is to hold: monitor -> ``thresholds``."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for proposal in proposals:
        mine = found.setdefault(proposal.monitor, {"thresholds": {}})
        mine["thresholds"][proposal.symptom] = proposal.threshold
    return found
