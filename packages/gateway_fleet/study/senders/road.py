"""The ROAD dataset of Oak Ridge National Laboratory, where a person has it: real attacks on one car.

Verma et al. 2024, A comprehensive guide to CAN IDS data and introduction of the ROAD dataset, PLOS ONE 19(1). Its
folders ``ambient`` and ``attacks`` have candump logs, and ``attacks/capture_metadata.json`` says of each capture, by
its name, when frames were injected (``injection_interval``, seconds from its begin, or null) and which
(``injection_id``).
"""

from __future__ import annotations

import json as json_text
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gateway.bus.logs import LogReader
from gateway.config.load import load_config
from gateway.engine.events import QUALIFIED_FAILED, STRANGER, Events
from gateway.runtime.assemble import prepare
from gateway_fdi.errors import InputError
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.learn import Asked, learn, write


def road(folder: Path, *, json: bool) -> int:
    """Learn of the ambient captures, replay those with attacks, and tell what was found; returns the exit code.

    Raises:
        InputError: the folder is none of ROAD's.
    """
    path = folder / "attacks" / "capture_metadata.json"
    try:
        captures: Mapping[str, Mapping[str, Any]] = json_text.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"this is no folder of ROAD: {error}", file=path) from error
    logs = tuple(sorted((folder / "ambient").glob("*.log")))
    if not logs:
        raise InputError("no capture (*.log) is there", file=folder / "ambient")
    rows = []
    with tempfile.TemporaryDirectory() as work:
        out = Path(work) / "road.toml"
        bus = BusAsked("can0", "virtual:can0", ())
        result = learn(Asked("road", (bus,), logs, out), lambda *_: None)
        write(result.files(out))
        for name, about in captures.items():
            rows.append({"capture": name} | _replayed(out, folder / "attacks" / f"{name}.log", about))
            if not json:
                print("; ".join(f"{key} {value}" for key, value in rows[-1].items()))
    attacked = [row for row in rows if row["from_s"] is not None]
    told = {"captures": rows, "attacked": len(attacked), "found": sum(row["after_s"] is not None for row in attacked)}
    print(json_text.dumps(told) if json else f"{told['found']} of {told['attacked']} attacks found")
    return 0


def _replayed(out: Path, log: Path, about: Mapping[str, Any]) -> dict[str, Any]:
    """Return when an attack was found, by which fault, and how many events came while there was none."""
    interval = about.get("injection_interval")
    from_s, to_s = (None, None) if interval is None else (float(interval[0]), float(interval[1]))
    engine = prepare(load_config(out), out).engine
    events_s: list[tuple[float, str]] = []
    start_ns: int | None = None

    def hear(events: Events) -> None:
        for event in events:
            if start_ns is not None and event["kind"] in (QUALIFIED_FAILED, STRANGER):
                name = "unknown" if event["kind"] == STRANGER else engine.faults[int(event["fault"])].id
                events_s.append(((int(event["t_ns"]) - start_ns) * 1e-9, name))

    for frames in LogReader(log, {"can0": 0}):
        start_ns = int(frames["t_ns"][0]) if start_ns is None else start_ns
        engine.process(frames, hear)
    within = [
        (s, name) for s, name in events_s if from_s is not None and to_s is not None and from_s <= s <= to_s + 1.0
    ]
    before = [name for s, name in events_s if from_s is None or s < from_s]
    first = min(within, default=None)
    return {
        "identifier": about.get("injection_id"),
        "from_s": from_s,
        "after_s": None if first is None or from_s is None else round(first[0] - from_s, 3),
        "by": None if first is None else first[1],
        "healthy_events": before,
    }
