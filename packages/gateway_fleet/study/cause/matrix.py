"""The matrix: single faults, pairs of faults, and nothing, over plants and cars."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gateway_bench import study_pool as pool
from gateway_fdi.diagnosis.system import PRIORS
from gateway_fleet.study.cause.cars import BEGIN_S, END_S, Car, Injected, injected
from gateway_fleet.study.cause.cases import Fault, Truth, alike, drawn, faults, read
from gateway_fleet.study.cause.drive import diagnoses, played, recorded
from gateway_fleet.study.cause.judge import Verdict, judge

#: Time that the second fault of a pair begins behind the first, as a share of how long that lasts.
_LATER = 0.3
#: A pair lasts so many times as long as its longer one: isolation waits longer where no single fault explains it.
_LONGER = 2.0


@dataclass(frozen=True)
class Job:
    """One run.

    Attributes:
        plant: which plant or car.
        name: of its faults.
        seed: of all its randomness.
        faults: of a plant.
        injected: into a car's drive.
        base: scenario of a healthy run.
    """

    plant: str
    name: str
    seed: int
    faults: tuple[Fault, ...] = ()
    injected: tuple[Injected, ...] = ()
    base: str = ""


@dataclass(frozen=True)
class Row:
    """A run, and what came of it.

    Attributes:
        plant, name, seed: as the job has them.
        seconds: how long it was.
        verdict: what came of it.
        part: the parts that one of is at fault, if one fault was put in.
        rate: how often one of them is, by its prior.
    """

    plant: str
    name: str
    seed: int
    seconds: float
    verdict: Verdict
    part: str = ""
    rate: float = 0.0


def run(job: Job) -> list[Row]:
    """Return what comes of a run."""
    rng = np.random.default_rng([job.seed, *job.name.encode()])
    if job.injected:
        return [_of_car(job, rng)]
    if not job.faults:
        seconds = float(read(job.base)["duration_s"])
        told = diagnoses(*played(job.base, (), seconds, job.seed))
        return [Row(job.plant, job.name, job.seed, seconds, judge(told, (), seconds, seconds))]
    entries = [drawn(fault, rng) for fault in job.faults]
    if len(entries) > 1:
        first, second = job.faults
        later = first.entry["from_s"] + rng.uniform(0.0, _LATER) * first.lasts_s
        entries[1]["from_s"] = round(later, 3)
        entries[1]["to_s"] = entries[0]["to_s"] = round(later + _LONGER * max(first.lasts_s, second.lasts_s), 3)
    begin, end = min(one["from_s"] for one in entries), max(one["to_s"] for one in entries)
    told = diagnoses(*played(job.faults[0].base, entries, end, job.seed))
    same = alike(*job.faults) if len(job.faults) > 1 else ()
    verdict = judge(told, [f.truth for f in job.faults], begin, end, same)
    return [Row(job.plant, job.name, job.seed, end, verdict, *_part(job.faults[0].truth, len(job.faults)))]


def _part(parts: Truth, count: int) -> tuple[str, float]:
    """Return the parts of the fault of a run, and how often one of them fails; of two faults nothing."""
    if count > 1:
        return "", 0.0
    rates = (rate for kind, rate in PRIORS.items() for name in parts if name.startswith(f"{kind} "))
    return " or ".join(sorted(parts)), sum(rates)


def _of_car(job: Job, rng: np.random.Generator) -> Row:
    car = job.injected[0].car
    begin = round(BEGIN_S + rng.uniform(0.0, 2.0), 3)
    texts = [f"{one.drawn(rng)} @{begin + 0.5 * k:.3f}..{END_S + 2.0:g}" for k, one in enumerate(job.injected)]
    config, frames = recorded(car.log, car.config, texts, job.seed)
    frames = frames[frames["t_ns"] - frames["t_ns"][0] <= END_S * 1e9]
    told = diagnoses(config, frames)
    verdict = judge(told, [one.truth for one in job.injected], begin, END_S)
    return Row(job.plant, job.name, job.seed, END_S, verdict, *_part(job.injected[0].part, len(texts)))


def singles(seeds: Sequence[int], cars: Sequence[Car]) -> Iterator[Job]:
    """Yield runs with one fault each, of each seed."""
    for seed in seeds:
        for fault in faults():
            yield Job(fault.plant, fault.name, seed, (fault,))
        for car in cars:
            for one in injected(car):
                yield Job(car.name, one.text, seed, injected=(one,))


def pairs(count: int, seed: int, cars: Sequence[Car], plants: Sequence[str] = ()) -> Iterator[Job]:
    """Yield runs with two faults of different components each."""
    rng = np.random.default_rng([seed, 2])
    single = [fault for fault in faults() if not plants or fault.plant in plants]
    groups: list[list[Fault] | list[Injected]] = []
    for base in dict.fromkeys(fault.base for fault in single):
        mine = [fault for fault in single if fault.base == base]
        if len({fault.truth for fault in mine}) > 1:
            groups.append(mine)
    groups += [list(injected(car)) for car in cars]
    for k in range(count):
        group = groups[k % len(groups)]
        apart = [(one, other) for one in group for other in group if _apart(one, other)]
        first, second = apart[int(rng.integers(len(apart)))]
        yield pair_of(first, second, seed + k)


def _apart(one: Fault | Injected, other: Fault | Injected) -> bool:
    """Return whether two faults are of different parts, and neither hides the other.

    A relation is not tested while a message of it is missing or wrong, or a signal of it is out of its range, so that
    an offset does not show.
    """
    if isinstance(one, Injected) and isinstance(other, Injected) and (one.hides(other) or other.hides(one)):
        return False
    frames = [each.of_frames for each in (one, other)]
    return not one.truth & other.truth and frames[0] == frames[1]


def pair_of(first: Fault | Injected, second: Fault | Injected, seed: int) -> Job:
    """Return a run with two faults of one plant, or of one car."""
    if isinstance(first, Fault) and isinstance(second, Fault):
        return Job(first.plant, f"{first.name} + {second.name}", seed, (first, second))
    assert isinstance(first, Injected)
    assert isinstance(second, Injected)
    return Job(first.car.name, f"{first.text} + {second.text}", seed, injected=(first, second))


def healthy(seeds: Sequence[int]) -> Iterator[Job]:
    """Yield runs of each scenario without its faults."""
    for seed in seeds:
        for base, plant in dict.fromkeys((fault.base, fault.plant) for fault in faults()):
            yield Job(plant, f"healthy {base}", seed, base=base)


def done(jobs: Sequence[Job], progress: Callable[[], None] = lambda: None) -> list[Row]:
    """Return the rows of all runs."""
    return pool.run(run, jobs, progress)


def folder_of(path: Path | None) -> Path:
    """Return a folder for what is learned, made if need be."""
    made = path or Path("cause")
    made.mkdir(parents=True, exist_ok=True)
    return made
