"""``gateway workshop``: how many frames of each identifier a log has."""

from collections import Counter
from pathlib import Path

import typer

from gateway.bus.logs import LogReader


def workshop(log: Path) -> None:
    """Count the frames of a log by their identifiers."""
    counts: Counter[int] = Counter()
    for frames in LogReader(log):
        counts.update(frames["can_id"].tolist())
    for can_id, count in sorted(counts.items()):
        typer.echo(f"{can_id:03X}  {count}")
