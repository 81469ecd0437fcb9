"""Hours of the foreign plants without a fault, and faults: as their models say, and off within what is told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gateway.config.load import load_config
from gateway_plants.structural.study.drives import (
    as_bought,
    calibrated,
    codes,
    configuration,
    frames_of,
    off,
    run,
    told_as,
)
from gateway_plants.structural.study.foreign import Plant

#: Healthy drives that thresholds are found on, by their seeds, and their length in those of a drive with a fault.
CALIBRATION, LENGTH = range(1, 11), 1.0
#: Samples of a healthy drive, and its length at most [s].
SAMPLES, LONGEST_S = 60_000, 3600.0


@dataclass(frozen=True)
class Row:
    """What was said of one plant.

    Attributes:
        plant: its name.
        share: by which parameters are off; 0: the plant is as its model says, its sensors are exact.
        hours: of healthy drives [h].
        false: of their seeds those with a code, and their first code.
        runs: with a fault.
        named: told first, and only, by its name or that of its group.
        later: by its name or its group's, behind ``unisolated`` or a group.
        group: only as ``unisolated``, or by a group that it is in.
        unseen: not at all.
        wrong: fault, seed and codes of those with a code before the fault, or one of another fault.
        delay_s: median from the fault to its name [s].
    """

    plant: str
    share: float
    hours: float
    false: tuple[tuple[int, str], ...]
    runs: int
    named: int
    later: int
    group: int
    unseen: int
    wrong: tuple[tuple[str, int, tuple[str, ...]], ...]
    delay_s: float


def _judged(right: str, fault: str, onset: float, found: list[tuple[float, str]]) -> str:
    """Return what a drive's codes say of its fault, by the names of :class:`Row`."""
    if any(t < onset or (name != "unisolated" and fault not in name.split("_or_")) for t, name in found):
        return "wrong"
    if not found:
        return "unseen"
    names = [name for _, name in found]
    return "group" if right not in names else "named" if names[0] == right else "later"


def evaluate(plant: Plant, share: float, hours: float, runs: int, seed: int, folder: Path) -> Row:
    """Return what is said of a plant.

    Args:
        share: by which its parameters are off.
        hours: of healthy drives [h].
        runs: with each fault.
        seed: first one; each drive has its own.
        folder: for the configuration.
    """
    file = configuration(plant, folder, plant.told if share else "")
    calibrated(file, *(frames_of(plant, run(plant, LENGTH * plant.seconds, k)) for k in CALIBRATION))
    config = load_config(file)

    def told(seconds: float, seed: int, fault: str = "", onset: float = 0.0) -> list[tuple[float, str]]:
        rows = run(plant, seconds, seed, fault, onset, off(plant, share, seed))
        return codes(config, file, frames_of(plant, as_bought(plant, rows, seed) if share else rows))

    seconds = min(SAMPLES * plant.period_s, LONGEST_S)
    drives = range(seed, seed + round(3600 * hours / seconds))
    false = tuple((k, found[0][1]) for k in drives if (found := told(seconds, k)))
    counts, wrong, delays = dict.fromkeys(("named", "later", "group", "unseen", "wrong"), 0), [], []
    for k, fault in _cases(plant, runs, seed):
        onset = plant.seconds * float(np.random.default_rng([k, 3]).uniform(0.45, 0.55))
        found = told(plant.seconds, k, fault, onset)
        right = told_as(config, file, fault)
        kind = _judged(right, fault, onset, found)
        counts[kind] += 1
        if kind == "wrong":
            wrong.append((fault, k, tuple(name for _, name in found)))
        delays += [t - onset for t, name in found if name == right][:1]
    assert counts.pop("wrong") == len(wrong)
    return Row(
        plant.name, share, len(drives) * seconds / 3600, false, runs * len(plant.faults), **counts,
        wrong=tuple(wrong), delay_s=float(np.median(delays)) if delays else float("nan"),
    )  # fmt: skip


def _cases(plant: Plant, runs: int, seed: int) -> Iterator[tuple[int, str]]:
    for n in range(runs):
        for k, fault in enumerate(plant.faults):
            yield seed + 5000 + n * len(plant.faults) + k, fault
