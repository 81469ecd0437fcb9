"""The pictures of docs/cause.md: which faults fail when, and how probable each cause is meanwhile."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt

from gateway.bus.frames import Frames
from gateway.config.model import Config
from gateway.engine.depends.params import DiagnosisParams, SupplyParams
from gateway_fleet.study.cause.cars import learned
from gateway_fleet.study.cause.cases import read
from gateway_fleet.study.cause.drive import events_of, injected_into, played, recorded
from gateway_replay.drawing import save

#: Causes that are drawn, of those that were the first or the second at some time.
_MOST = 4
#: Length of a name that needs a line of the legend for itself.
_LONG = 40
#: A supply of two wheels (docs/cause.md).
_SUPPLY = DiagnosisParams(supply=(SupplyParams(name="front_5V", feeds=("WheelSpeeds.FL", "WheelSpeeds.FR")),))


class _Case(NamedTuple):
    """A case: its name and title, what is played to which configuration, and the time that is drawn [s]."""

    name: str
    title: str
    config: Config
    frames: Frames
    begin_s: float
    end_s: float


@dataclass
class _Course:
    """What was told: when each fault failed [s], and how probable each cause was from when on [s]."""

    failed: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    times: list[float] = field(default_factory=list)
    probable: list[Mapping[str, float]] = field(default_factory=list)
    proven: list[str] = field(default_factory=list)


def draw_all(folder: Path, work: Path) -> list[Path]:
    """Draw each case into a file of a folder; returns the files. ``work``: folder for cars that are learned."""
    folder.mkdir(parents=True, exist_ok=True)
    return [_draw(folder / f"cause-{case.name}.svg", case) for case in _cases(work)]


def _cases(folder: Path) -> Iterator[_Case]:
    car, vehicle = learned(folder)
    title, wrong = "SPEED is 40 too high from 20 s to 25 s", ["offset SPEED.SPEED=40 @20..25"]
    yield _Case("speed", title, *recorded(car.log, car.config, wrong, 1), 19.5, 29.0)
    config, frames = played("signals_faults", (), 6.0, 1)
    silent = [f"drop {name} @2..4" for name in ("WheelSpeeds", "Vehicle", "Climate")]
    title = "nobody is heard from 2 s to 4 s"
    yield _Case("silent", title, config, injected_into(config, frames, silent, 1), 1.5, 5.0)
    dead = [f"drop {name} @20..26" for name in ("Vehicle", "Climate")]
    title = "Body is dead from 20 s to 26 s"
    yield _Case("ecu", title, *recorded(vehicle.log, vehicle.config, dead, 1), 19.0, 28.0)
    high = ["value WheelSpeeds.FR=320 @2..5", "value WheelSpeeds.FL=320 @3..5"]
    fed = config.model_copy(update={"diagnosis": _SUPPLY})
    title = "FR is above its range from 2 s on, FL from 3 s"
    yield _Case("supply", title, fed, injected_into(fed, frames, high, 1), 1.5, 6.0)
    entries = [one for one in read("brake_faults")["fault"] if one["name"] in ("f_R", "f_F")]
    faults = [{**one, "from_s": 20.0, "to_s": 60.0} for one in entries]
    title = "resistance and force's sensor are wrong from 20 s on"
    yield _Case("plant", title, *played("brake_faults", faults, 60.0, 1), 15.0, 60.0)


def _course(events: Sequence[Mapping[str, Any]], start_ns: int) -> _Course:
    course, begun = _Course(), dict[str, float]()
    for event in events:
        t_s = (event["t_ns"] - start_ns) * 1e-9
        if event["event"] == "dtc" and event["status"] & 1:
            begun.setdefault(event["fault"], t_s)
        elif event["event"] == "dtc" and event["fault"] in begun:
            course.failed.setdefault(event["fault"], []).append((begun.pop(event["fault"]), t_s))
        elif event["event"] == "diagnosis":
            told = [(" & ".join(c["components"]) or "false alarm", c) for g in event["groups"] for c in g["causes"]]
            course.times.append(t_s)
            course.probable.append({name: cause["probability"] for name, cause in told})
            proven = [" & ".join(group["cause"]) for group in event["groups"] if group["cause"]]
            course.proven.append(proven[0] if proven else "")
    for fault, t_s in begun.items():
        course.failed.setdefault(fault, []).append((t_s, math.inf))
    return course


def _draw(path: Path, case: _Case) -> Path:
    begin_s, end_s = case.begin_s, case.end_s
    course = _course(events_of(case.config, case.frames), int(case.frames["t_ns"][0]))
    rows = list(course.failed)
    sizes = [0.3 * len(rows) + 0.3, 2.2]
    plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": case.name})  # the same file each time
    figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8.5, sum(sizes) + 1.4), height_ratios=sizes)
    for k, fault in enumerate(rows):
        spans = [(a, min(b, end_s) - a) for a, b in course.failed[fault] if a < end_s]
        above.broken_barh(spans, (k - 0.35, 0.7), color="#b03a2e")
    above.set_yticks(range(len(rows)), rows, fontsize="x-small")
    above.invert_yaxis()
    above.set_title(f"{case.title}: what fails", loc="left", fontsize="medium")
    ranked = [name for one in course.probable for name in sorted(one, key=lambda n: -one[n])[:2]]
    shown = list(dict.fromkeys(ranked))[:_MOST]
    for k, name in enumerate(shown):
        times = [begin_s, *course.times, end_s]
        values = [0.0, *(one.get(name, 0.0) for one in course.probable)]
        line = below.stairs(values, times, baseline=None, label=name, color=f"C{k}", linewidth=1.5)
        sure = [v if name == proven else math.nan for v, proven in zip(values, ["", *course.proven], strict=True)]
        below.stairs(sure, times, baseline=None, color=line.get_edgecolor(), linewidth=4.0)
    below.set_title("how probable each cause is (thick: told as the cause)", loc="left", fontsize="medium")
    below.set(xlim=(begin_s, end_s), ylim=(-0.03, 1.05), xlabel="s")
    columns = 2 if max(map(len, shown)) < _LONG else 1
    below.legend(fontsize="small", loc="upper left", bbox_to_anchor=(0.0, -0.25), ncols=columns, frameon=False)
    return save(figure, path)
