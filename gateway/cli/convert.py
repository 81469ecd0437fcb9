"""``gateway convert``: other recordings into CAN logs, and logs of one format into those of another."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gateway.bus.logs import open_writer
from gateway.bus.ring import read_recording
from gateway.cli.present import print_json, say
from gateway.errors import InputError, InputErrors
from gateway.fdi.wheel_told import data, see, told
from gateway.vecu.crank.capture import read_capture
from gateway.vecu.crank.tooth_frames import Format, tooth_frames


def convert_teeth(capture: Path, log: Path, *, channel: str, edge: str, frame: str, json: bool) -> int:
    """Convert a crank sensor's capture; returns the exit code."""
    if edge not in ("rising", "falling"):
        raise InputError("the edges are rising and falling", key="--edge", value=edge)
    if frame not in ("classic", "fd"):
        raise InputError("the frames are classic and fd", key="--frame", value=frame)
    teeth = read_capture(capture, channel=channel, edge=edge)
    form: Format = "fd" if frame == "fd" else "classic"
    frames = tooth_frames(teeth.times_ns, form)
    with open_writer(log) as writer:
        writer.write(frames)
    seen = see(np.diff(teeth.times_ns) / 1e3)
    facts = {"edges": teeth.edges, "seconds": teeth.duration_s, "frames": len(frames), "wheel": data(seen)}
    if json:
        print_json(facts)
    else:
        print(f"{capture}: {teeth.edges} {edge} edges in {teeth.duration_s:.3f} s -> {log}: {len(frames)} frames")
        print(f"wheel seen: {told(seen)}")
    return 0


#: Buses of a batch (``FRAME["bus"]`` is a byte).
_MOST = 256


def convert_log(source: Path, log: Path, *, json: bool) -> int:
    """Write a log in another format; returns the exit code.

    It is read twice: formats whose channels have names get these, in the order in which they come.

    Raises:
        InputError, InputErrors: a log that is damaged; what came before has been written.
    """
    if log.exists() and source.exists() and log.samefile(source):
        raise InputError("a log is not converted into itself", file=log)
    wrong: list[InputError] = []
    names = _channels(source)
    reader = read_recording(source, {name: k for k, name in enumerate(names)})
    count = 0
    with open_writer(log, interfaces=dict(enumerate(names))) as writer:
        try:
            for frames in reader:
                if reader.origin_ns:
                    frames["t_ns"] += reader.origin_ns
                writer.write(frames)
                count += len(frames)
        except InputError as error:
            wrong.append(error)
    wrong += reader.problems
    facts = {"log": str(log), "frames": count, "channels": names, "reasons": [str(error) for error in wrong]}
    if json:
        print_json(facts)
    else:
        print(f"{source}: {count} frames of {', '.join(names) or 'no channel'} -> {log}")
        if reader.passed_over:
            say(f"{source}: {len(reader.passed_over)} places could not be read: {reader.passed_over[0]}")
    if wrong:
        raise InputErrors(wrong)
    return 0


def _channels(source: Path) -> list[str]:
    """Return the names of a log's channels; numbers stay what they are, where they can."""
    reader = read_recording(source)
    try:
        for _ in reader:
            pass
    except InputError:
        pass  # told when it is read again
    seen = list(reader.seen)
    if len(seen) > _MOST:
        raise InputError(f"{len(seen)} channels; {_MOST} is the most that a log is written with", file=source)
    numbers = [int(name) for name in seen if name.isdecimal()]
    if seen and len(numbers) == len(seen) and max(numbers) < _MOST:
        return [str(number) for number in range(max(numbers) + 1)]
    return seen
