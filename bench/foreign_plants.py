"""What is said of plants of other make, whose models are a little wrong: a car, an engine's air path, a PM motor.

    python bench/foreign_plants.py calibrate|singles|pairs|start|healthy ... [--plant NAME] [--seed S] [--count N]

Each drive is of another plant (:mod:`foreign`), 5 to 8 % off and not quite of the model's structure, made by a solver
of its own, with quantised signals and a frame in a thousand lost. The gateway is calibrated on ten healthy drives of
300 s, seeds 1 to 10, once a folder, and plays each drive frame by frame as the daemon does.

Plants of the arena (spring, buck, stiff_motor, quad, wind) have the model's structure, and parameters that are 5 % off.
Only singles and healthy drives are of use there; their times are longer or shorter by their pace.

- singles: one fault from 40 to 60 s on, 120 s in all. pairs: a second one at once, or up to 20 s later.
- start: one from before the start; from 2 to 15 s on; or intermittent at 1 to 10 Hz, in turn.
- healthy: drives of 300 s.

The first statement is the first DTC: right (its name, or that of its structural group), one of (at most three, of
which it is one), open (nobody is named: for a fault from the start, "cannot know"), other, early (before there is one),
silent. Proven is what the cause says at 0.99 at least; wrong if a healthy part is in it. Reliability counts each run
once, by what was told last. Intervals are Wilson's, 95 %.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it

import numpy as np
from foreign.air import AIR
from foreign.arena import ARENA
from foreign.car import CAR
from foreign.motor import MOTOR
from foreign.plant import Array, Plant

from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.faults.status import Status
from gateway.runtime.app import Gateway
from gateway_plants.structural.study.drives import BEGIN, calibrated, configuration, frames_of

OURS = (CAR, AIR, MOTOR)
PLANTS = {plant.name: plant for plant in (*OURS, *ARENA)}
HEALTHY, HEALTHY_S, FAULTY_S, LOST = range(1, 11), 300.0, 120.0, 1e-3
#: Faults of one statement, at most; quantile of the intervals.
MOST, Z = 3, 1.96
Fault = tuple[str, float, Array]


@dataclass(frozen=True)
class Row:
    """What was said of a drive.

    Attributes:
        faults: with their sizes, and when they began [s].
        first: kind of the first statement.
        said: it.
        after_s: from the first fault to it [s].
        proven: parts that were told as the cause at some time.
        healthy: of these those that are healthy.
        place: of all that is wrong, in what was told last; 0: nowhere.
        chance: probability of the likeliest of what was told last; 0: nothing was.
        right: whether that is all that is wrong, and nothing else.
    """

    seed: int
    faults: list[tuple[str, float, float]]
    first: str = "silent"
    said: str = ""
    after_s: float = math.nan
    proven: list[str] = field(default_factory=list)
    healthy: list[str] = field(default_factory=list)
    place: int = 0
    chance: float = 0.0
    right: bool = False


def events_of(plant: Plant, config: Config, file: Path, seed: int, seconds: float, faults: Iterable[Fault] = ()) -> Any:
    """Return the events of a drive."""
    effects = {name: size * course for name, size, course in faults}
    frames = frames_of(plant, plant.drive(seed, round(seconds / plant.period_s), effects))
    frames = frames[np.random.default_rng([seed, 2]).random(len(frames)) >= LOST]
    gateway, found = Gateway(config, None, file=file), []
    gateway.listen(found.append)
    gateway.start(int(frames[0]["t_ns"]))
    gateway.feed(frames)
    gateway.close()
    return found


def judged(plant: Plant, seed: int, faults: list[tuple[str, float, float]], events: list[Mapping[str, Any]]) -> Row:
    """Return what was said."""
    truth, begun = {plant.part(name) for name, *_ in faults}, min((t for *_, t in faults), default=math.inf)
    row = Row(seed, faults)
    codes = [e for e in events if e["event"] == "dtc" and e["status"] & Status.TEST_FAILED]
    if codes:
        at = (codes[0]["t_ns"] - BEGIN) * 1e-9
        first, said = statement(plant, {name for name, *_ in faults}, codes[0])
        row = replace(row, first=first if at >= begun else "early", said=said, after_s=at - begun)
    told = [e["groups"] for e in events if e["event"] == "diagnosis" and e["groups"]]
    proven = {part for groups in told for group in groups for part in group["cause"] or ()}
    row = replace(row, proven=sorted(proven), healthy=sorted(proven - truth))
    if not told:
        return row
    whole = [
        ({part for one in chosen for part in one["components"]}, math.prod(one["probability"] for one in chosen))
        for chosen in itertools.product(*(group["causes"] for group in told[-1]))
    ]
    ranked = [parts for parts, _ in sorted(whole, key=lambda one: -one[1])]
    place = ranked.index(truth) + 1 if truth in ranked else 0
    return replace(row, place=place, chance=max(p for _, p in whole), right=place == 1)


def statement(plant: Plant, faults: set[str], code: Mapping[str, Any]) -> tuple[str, str]:
    """Return what kind of statement a DTC is, and it."""
    name = code["fault"].partition(".")[2]
    if name != "unisolated":
        return ("right" if faults & set(name.split("_or_")) else "other"), name
    ranked = next((value for key, value in code["evidence"].items() if "likeliest first" in key), None) or 0
    texts, places = list(plant.faults), []
    while ranked >= 1:
        ranked, place = divmod(int(ranked), 100)
        places.append(texts[place - 1])
    kind = "open" if not 0 < len(places) <= MOST else "one of" if faults & set(places) else "other"
    return kind, f"unisolated: {', '.join(places)}"


def drawn(plant: Plant, command: str, number: int, seed: int) -> list[tuple[Fault, float]]:
    """Return the faults of a drive, and when they begin [s]: each fault and size in turn, pairs at random."""
    rng, count = np.random.default_rng([seed, 3]), round(FAULTY_S * plant.pace / plant.period_s)
    t = np.arange(count) * plant.period_s
    every = [(name, size) for name, sizes in plant.faults.items() for size in sizes]
    onset = float(rng.uniform(40.0, 60.0)) * plant.pace
    if command == "singles":
        return [((*every[number % len(every)], 1.0 * (t >= onset)), onset)]
    if command == "pairs":
        names = rng.choice(list(plant.faults), 2, replace=False).tolist()
        onsets = [onset, onset + (float(rng.uniform(0.0, 20.0)) if number % 3 else 0.0)]
        sizes = [float(rng.choice(plant.faults[name])) for name in names]
        return [((n, s, 1.0 * (t >= at)), at) for n, s, at in zip(names, sizes, onsets, strict=True)]
    name, size = every[int(rng.integers(len(every)))]
    onset = (0.0, float(rng.uniform(2.0, 15.0)), onset)[number % 3]
    hertz = rng.uniform(1.0, 10.0)
    there = (np.mod((t - onset) * hertz, 1.0) < 0.5) if number % 3 == 2 else np.ones(count, bool)
    return [((name, size, 1.0 * ((t >= onset) & there)), onset)]


def share(hits: int, runs: int) -> str:
    """Return a share with Wilson's interval."""
    if not runs:
        return "-"
    p, z2 = hits / runs, Z * Z
    middle, apart = p + z2 / (2 * runs), Z * math.sqrt(p * (1 - p) / runs + z2 / (4 * runs * runs))
    low, high = (max(middle + sign * apart, 0.0) / (1 + z2 / runs) for sign in (-1, 1))
    return f"{hits} of {runs} = {p:.0%} ({low:.0%} to {high:.0%})"


def report(name: str, command: str, rows: list[Row]) -> None:
    """Print the table of a plant."""
    kinds = Counter(row.first for row in rows)
    print(f"\n{name}, {command}: {len(rows)} drives, seeds {rows[0].seed} to {rows[-1].seed}")
    spoken = [row for row in rows if row.first != "silent"]
    if command == "healthy":
        print(f"  drives with a code   {share(len(spoken), len(rows))}")
        return
    print(f"  right, or one of     {share(kinds['right'] + kinds['one of'], len(spoken))}", dict(kinds))
    print(f"  a healthy part       {share(kinds['other'] + kinds['early'], len(spoken))}")
    print(f"  silent               {share(kinds['silent'], len(rows))}")
    if command == "pairs":
        print(f"  both in first three  {share(sum(0 < row.place <= 3 for row in rows), len(rows))}")
        print(f"  both first           {share(sum(row.place == 1 for row in rows), len(rows))}")
    if hits := [row.after_s for row in spoken if row.first in ("right", "one of")]:
        print(f"  median time          {np.median(hits):.1f} s")
    proven = [row for row in rows if row.proven]
    print(f"  proven, wrong        {share(sum(bool(row.healthy) for row in proven), len(proven))}")
    for low, high in itertools.pairwise([*(k / 10 for k in range(10)), 0.99, 1.01]):
        if mine := [row for row in rows if row.chance and low <= row.chance < high]:
            mean, right = sum(row.chance for row in mine) / len(mine), sum(row.right for row in mine)
            print(f"  told {low:.2g} to {min(high, 1):.2g}: mean {mean:.3f}, right {share(right, len(mine))}")


def prepared(plant: Plant, folder: Path) -> Path:
    """Return the configuration of a plant, calibrated on healthy drives if it is not yet."""
    folder = folder / plant.name
    file = folder / "gateway.toml"
    if not file.exists() or "calibrated" not in file.read_text():
        folder.mkdir(parents=True, exist_ok=True)
        configuration(plant, folder)
        count = round(HEALTHY_S * plant.pace / plant.period_s)
        calibrated(file, *(frames_of(plant, plant.drive(k, count, {})) for k in HEALTHY))
    return file


def rows_of(plant: Plant, file: Path, command: str, args: argparse.Namespace) -> Iterator[Row]:
    """Yield what is said of each drive."""
    config = load_config(file)
    for number, seed in enumerate(range(args.seed, args.seed + args.count)):
        faults = [] if command == "healthy" else drawn(plant, command, number, seed)
        seconds = plant.pace * (HEALTHY_S if command == "healthy" else FAULTY_S)
        events = events_of(plant, config, file, seed, seconds, [fault for fault, _ in faults])
        row = judged(plant, seed, [(f[0], f[1], at) for f, at in faults], events)
        if args.json:
            with args.json.open("a") as out:
                out.write(json.dumps({"plant": plant.name, "command": command, **asdict(row)}) + "\n")
        yield row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="+", choices=("calibrate", "singles", "pairs", "start", "healthy"))
    parser.add_argument("--plant", choices=PLANTS, action="append")
    parser.add_argument("--seed", type=int, default=1000, help="of the first drive")
    parser.add_argument("--count", type=int, default=30, help="drives of each plant")
    parser.add_argument("--folder", type=Path, default=Path("foreign_plants"), help="of the calibrated configurations")
    parser.add_argument("--json", type=Path, help="file for a line of each drive")
    args = parser.parse_args()
    for name in args.plant or [plant.name for plant in OURS]:
        file = prepared(PLANTS[name], args.folder)
        print(f"{name}: {file}")
        for command in args.commands:
            if command != "calibrate":
                report(name, command, list(rows_of(PLANTS[name], file, command, args)))


if __name__ == "__main__":
    main()
