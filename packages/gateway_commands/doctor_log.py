"""``gateway doctor LOG``: what a log holds, channel by channel, and what of it could not be read."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, OWN, REMOTE, Frames
from gateway.bus.logs import LogReader
from gateway.cli.present import print_json
from gateway_commands.convert import channels_in
from gateway_fdi.errors import InputError, InputErrors

#: Kinds of frames: bits of the identifier, and of the flags.
_KINDS = {"extended": (EXTENDED, 0), "remote": (REMOTE, 0), "error": (ERROR, 0)}
_KINDS |= {"fd": (0, FD), "brs": (0, BRS), "esi": (0, ESI)}
#: Stamps from here on are wall time: 1980-01-01 [ns].
_WALL_NS = 315_532_800 * 10**9


def _count(channel: dict[str, Any], frames: Frames) -> None:
    """Count frames of a channel."""
    sent = int((frames["flags"] & OWN != 0).sum())
    channel["frames"] += len(frames)
    channel["sent"] += sent
    channel["received"] += len(frames) - sent
    for name, (bits, flags) in _KINDS.items():
        here = (frames["can_id"] & np.uint32(bits) != 0) if bits else frames["flags"] & flags != 0
        channel["kinds"][name] += int(here.sum())
    first, last = int(frames["t_ns"].min()), int(frames["t_ns"].max())
    channel["first_ns"] = first if channel["first_ns"] is None else min(first, channel["first_ns"])
    channel["last_ns"] = last if channel["last_ns"] is None else max(last, channel["last_ns"])


def describe(source: Path, zone: tzinfo, *, json: bool) -> int:
    """Tell what a log holds; returns the exit code.

    Raises:
        InputError, InputErrors: it is damaged; the rest has been told.
    """
    names = channels_in(source)
    found: list[dict[str, Any]] = [
        {
            "channel": name, "frames": 0, "received": 0, "sent": 0, "first_ns": None, "last_ns": None,
            "kinds": dict.fromkeys(_KINDS, 0),
        }
        for name in names
    ]  # fmt: skip
    reader = LogReader(source, {name: k for k, name in enumerate(names)}, zone)
    wrong: list[InputError] = []
    try:
        for frames in reader:
            frames["t_ns"] += reader.origin_ns
            for bus in np.unique(frames["bus"]).tolist():
                _count(found[bus], frames[frames["bus"] == bus])
    except InputError as error:
        wrong.append(error)
    wrong += reader.problems
    found = [channel for channel in found if channel["frames"]]
    passed = [{"kind": kind, **asdict(one)} for kind, one in reader.passed_over.kinds.items()]
    facts = {
        "log": str(source), "formats": reader.formats, "frames": sum(one["frames"] for one in found),
        "channels": found, "passed_over": passed, "reasons": [str(error) for error in wrong],
    }  # fmt: skip
    if json:
        print_json(facts)
    else:
        _print(facts, reader.passed_over.notes())
    if wrong:
        raise InputErrors(wrong)
    return 0


def _print(facts: dict[str, Any], notes: list[str]) -> None:
    print(f"{facts['log']}: {', '.join(facts['formats'])}, {facts['frames']} frames")
    for one in facts["channels"]:
        kinds = ", ".join(f"{count} {name}" for name, count in one["kinds"].items() if count)
        way = f"{one['received']} received, {one['sent']} sent"
        span = f"{_time(one['first_ns'])} to {_time(one['last_ns'])}"
        print(f"  channel {one['channel']}: {one['frames']} frames ({way}{'; ' if kinds else ''}{kinds}), {span}")
    for note in notes:
        print(f"  {note}")


def _time(t_ns: int) -> str:
    if t_ns < _WALL_NS:
        return f"{t_ns / 1e9:.6f} s"
    return f"{datetime.fromtimestamp(t_ns // 10**9, UTC):%Y-%m-%dT%H:%M:%S}.{t_ns % 10**9:09d}Z"
