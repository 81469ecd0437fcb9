"""``gateway convert teeth``: a capture of a crank sensor into a CAN log."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gateway.bus.logs import open_writer
from gateway.cli.present import print_json
from gateway_fdi.errors import InputError
from gateway_plants.crank.ecu.capture import read_capture
from gateway_plants.crank.ecu.tooth_frames import Format, tooth_frames
from gateway_plants.crank.wheel_report import data, see, told


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
