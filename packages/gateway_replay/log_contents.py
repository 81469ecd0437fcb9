"""Contents of a log, and the errors and notes about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway.bus.log_source import CutOffError
from gateway.bus.logs import LogReader
from gateway_fdi.errors import InputError


@dataclass
class Contents:
    """Contents of a log that has been read.

    Attributes:
        file: the log.
        channels: frames of each channel in it.
        bus_of: name of the bus that a channel was taken as, None: left out.
        state: "whole", "empty", "foreign" (no frame of a configured bus, or none known), "cut off", "damaged".
        wrong: what is wrong with it, one error each.
        notes: remarks for people, one line each.
    """

    file: Path
    channels: dict[str, int]
    bus_of: dict[str, str | None]
    state: str = "whole"
    wrong: list[InputError] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def frames(self) -> int:
        """Frames in the log, left out or not."""
        return sum(self.channels.values())

    @property
    def left_out(self) -> int:
        """Frames of channels that no configured bus has."""
        return sum(n for name, n in self.channels.items() if self.bus_of[name] is None)

    def refuse(self, error: InputError, state: str = "", *, allowed: bool = False) -> None:
        """Note an error, as a remark if it is allowed, and the state that comes of it, if there is no other yet."""
        if state and self.state == "whole":
            self.state = state
        if allowed:
            self.notes.append(str(error))
        else:
            self.wrong.append(error)

    def event(self) -> dict[str, Any]:
        """Return it in the form of the JSON contract."""
        return {
            "event": "log",
            "file": str(self.file),
            "state": self.state,
            "frames": self.frames,
            "left_out": self.left_out,
            "channels": {name: {"bus": self.bus_of[name], "frames": count} for name, count in self.channels.items()},
            "notes": self.notes,
            "reasons": [str(error) for error in self.wrong],
        }


def contents(
    reader: LogReader,
    buses: Mapping[str, str],
    channels: Mapping[str, int] | None,
    *,
    asked: Sequence[str] = (),
    damage: InputError | None = None,
    foreign: str = "",
    allow_empty: bool = False,
    allow_cut: bool = False,
) -> Contents:
    """Say what a log held.

    Args:
        reader: that has read it.
        buses: name of each bus -> its usual name in logs, in their order.
        channels: channel -> bus index, as the reader had it.
        asked: channels that were joined to buses by hand.
        damage: what ended reading.
        foreign: how many of its identifiers the configuration knows, where these are too few; "": enough.
        allow_empty: a log without a frame of a configured bus is no error.
        allow_cut: nor is one that is cut off.
    """
    names = list(buses)
    seen = {name: count for name, count in sorted(reader.seen.items()) if count}
    places = {name: 0 if channels is None else channels.get(name) for name in seen}
    made = Contents(
        reader.path,
        seen,
        {name: None if place is None else names[place] for name, place in places.items()},
    )
    held = _listed(seen)
    known = ", ".join(a if a == b else f"{a} ({b})" for a, b in buses.items())
    wrong = [*reader.problems, *([] if damage is None else [damage])]
    for error in wrong:
        cut = isinstance(error, CutOffError)
        made.refuse(error, "cut off" if cut else "damaged", allowed=cut and allow_cut)
    if any(not isinstance(error, CutOffError) for error in wrong):
        made.state = "damaged"
    if not seen:
        if not wrong:
            hint = "" if allow_empty else " (--allow-empty if that is right)"
            error = InputError(f"no frame in this log{hint}", file=reader.path)
            made.refuse(error, "empty", allowed=allow_empty)
        return made
    if made.left_out == made.frames:
        text = (
            f"no frame of a configured bus: the log has {held}, the configuration {known};"
            f" join them, e.g. --map {next(iter(seen))}={names[0]}"
        )
        made.refuse(InputError(text, file=reader.path), "foreign", allowed=allow_empty)
    elif foreign:
        text = f"of another vehicle: the databases of the configuration know {foreign} of its identifiers"
        made.refuse(InputError(f"{text}; nothing was judged", file=reader.path), "foreign")
    else:
        made.notes += _notes(made, names, channels)
    for name in asked:
        if name not in seen:
            error = InputError(f"the log has no such channel; it has {held}", file=reader.path, key="--map", value=name)
            made.refuse(error, allowed=allow_empty)
    made.notes += reader.passed_over.notes()
    return made


def _notes(made: Contents, names: list[str], channels: Mapping[str, int] | None) -> list[str]:
    notes = []
    foreign = {name: n for name, n in made.channels.items() if made.bus_of[name] is None}
    if foreign:
        notes.append(
            f"{made.left_out} of {made.frames} frames left out, of no configured bus: {_listed(foreign)}"
            f" (--map {next(iter(foreign))}={names[0]} joins them)"
        )
    if channels is None and len(made.channels) > 1:
        notes.append(
            f"all channels are taken as {names[0]}: {_listed(made.channels)}"
            f" (--map {next(iter(made.channels))}={names[0]} takes one)"
        )
    silent = [name for name in names if name not in made.bus_of.values()]
    if silent:
        notes.append(f"no frame of {', '.join(silent)} in this log")
    return notes


def _listed(channels: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({count} frames)" for name, count in channels.items())
