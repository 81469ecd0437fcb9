"""``gateway convert``: other recordings into CAN logs."""

from __future__ import annotations

from pathlib import Path

from gateway.bus.logs import open_writer
from gateway.cli.present import print_json
from gateway.errors import InputError
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
    facts = {"edges": teeth.edges, "seconds": teeth.duration_s, "frames": len(frames)}
    if json:
        print_json(facts)
    else:
        print(f"{capture}: {teeth.edges} {edge} edges in {teeth.duration_s:.3f} s -> {log}: {len(frames)} frames")
    return 0
