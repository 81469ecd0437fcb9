"""Observations and written lines, kept beside the configuration: to add another drive, and to know a person's hand."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway_fdi.errors import InputError
from gateway_fleet.learn.course import Course
from gateway_fleet.learn.gaps import Gaps
from gateway_fleet.learn.lines import Learned, Line
from gateway_fleet.learn.observe import Observation, Seen

#: Place of a line, and a key of it.
Refused = tuple[tuple[str, str, str], str]

#: Form of the file; another one cannot be read.
FORM = 1


@dataclass
class Kept:
    """Findings of earlier logs.

    Attributes:
        seconds: their length [s].
        logs: read ones, for people.
        messages: (bus, message) -> its observation.
        written: lines as they were written, by place.
        refused: place and key of limits that healthy logs broke until they were taken out: they stay out.
    """

    seconds: float = 0.0
    logs: list[str] = field(default_factory=list)
    messages: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)
    written: dict[tuple[str, str, str], Line] = field(default_factory=dict)
    refused: set[Refused] = field(default_factory=set)


def state_path(out: Path) -> Path:
    """Return where what was seen is kept, beside a configuration."""
    return out.with_suffix(".learned.json")


def load_state(out: Path) -> Kept:
    """Read what earlier logs gave.

    Raises:
        InputError: it is not there, or is none.
    """
    path = state_path(out)
    try:
        data = json.loads(path.read_text())
        if data["form"] != FORM:
            raise InputError(f"form {data['form']} is not known here, {FORM} is: learn again", file=path, key="form")
        return Kept(
            data["seconds"],
            data["logs"],
            {(bus, name): entry for bus, name, entry in data["messages"]},
            {(bus, table, name): Line(bus, table, name, keys, why) for bus, table, name, keys, why in data["written"]},
            {((bus, table, name), key) for bus, table, name, key in data["refused"]},
        )
    except FileNotFoundError as error:
        text = "the state of earlier learning is not there: --update goes on from a file that gateway learn has made"
        raise InputError(text, file=path) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"this is not what gateway learn keeps: {error}", file=path) from error


def state_of(
    observation: Observation,
    learned: Learned,
    buses: Sequence[str],
    seconds: float,
    logs: Sequence[str],
    before: Kept,
    by_hand: Collection[tuple[str, str, str]],
    refused: Set[Refused],
) -> dict[str, Any]:
    """Return the state to be kept, after :func:`merge`; of a person's places, the lines that we wrote there last.

    Args:
        observation: of the new logs, with the earlier ones added.
        learned: lines as they are written now.
        buses: names, by index.
        seconds: length of all logs [s].
        logs: all of them, for people.
        before: findings of earlier logs.
        by_hand: places that a person changed, took out or added.
        refused: taken out now.
    """
    messages = dict(before.messages)
    for (bus, name), seen in observation.seen.items():
        messages[buses[bus], name] = {
            "frames": seen.frames,
            "lengths": {str(length): count for length, count in seen.lengths.items()},
            "ended_s": seen.ended_s,
            "gaps": seen.gaps.data(),
            "signals": {
                signal.name: course.data() for signal, course in zip(seen.signals, seen.courses.each, strict=True)
            },
        }
    written = [*learned.lines.values(), *(before.written[place] for place in by_hand if place in before.written)]
    return {
        "form": FORM,
        "seconds": seconds,
        "logs": list(logs),
        "messages": [[bus, name, entry] for (bus, name), entry in messages.items()],
        "written": [[line.bus, line.table, line.name, line.keys, line.why] for line in written],
        "refused": sorted([*place, key] for place, key in before.refused | refused),
    }


def merge(observation: Observation, before: Kept, buses: Sequence[str]) -> None:
    """Add what earlier logs gave to what was seen."""
    for (bus, name), seen in observation.seen.items():
        entry = before.messages.get((buses[bus], name))
        if entry is not None:
            _add(seen, entry)


def _add(seen: Seen, entry: Mapping[str, Any]) -> None:
    seen.frames += entry["frames"]
    seen.lengths.update({int(length): count for length, count in entry["lengths"].items()})
    seen.ended_s = max(seen.ended_s, entry["ended_s"])
    seen.gaps.join(Gaps.of(entry["gaps"]))
    for signal, course in zip(seen.signals, seen.courses.each, strict=True):
        if signal.name in entry["signals"]:
            course.join(Course.of(entry["signals"][signal.name]))
