"""``gateway evaluate senders``."""

from __future__ import annotations

import json as json_text
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import Frames
from gateway.bus.ring import read_recording
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.learn import Asked, learn, write
from gateway_fleet.study.learn.drive import Way, frames_of
from gateway_fleet.study.learn.judge import healthy, learned
from gateway_fleet.study.learn.network import network
from gateway_fleet.study.senders.attack import FORGED, KINDS, Bench, Found

#: How frames reach the log that is learned of, the drive that is attacked, and other healthy drives: as the bus has
#: them, and by a host that is late.
LEARNED, OTHER = Way(lost=0.01, batch_s=0.004), Way(sleeps=1, late=3, batch_s=0.004)
HEALTHY = (Way(sleeps=1, batch_s=0.004), Way(sleeps=1, batch_s=0.1))


def senders(*, cars: int, attacks: int, hours: float, files: tuple[Path, ...], seed: int, json: bool) -> int:
    """Attack virtual cars and logs, then replay healthy drives; returns the exit code."""
    found = {kind: Found() for kind in KINDS}
    databases = [path for path in files if path.suffix == ".dbc"]
    logs = [path for path in files if path not in databases]
    each = -(-attacks // (cars + len(logs)))
    codes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as work:
        outs = []
        for car in range(cars):
            folder = Path(work) / str(car)
            folder.mkdir()
            net = network(seed + car)
            out, result = learned(folder, net, frames_of(net, seed + car, 300.0, LEARNED))
            outs.append((out, net))
            other = frames_of(net, seed + 100 + car, 300.0, OTHER)
            _attack(Bench(out, other, result.trials.seeing, seed + car), found, each)
        for k, log in enumerate(logs):
            out = Path(work) / f"log{k}.toml"
            names = tuple(str(path.resolve()) for path in databases)
            bus = BusAsked("can0", "virtual:can0", names, files=names)
            result = learn(Asked("car", (bus,), (log,), out), lambda *_: None)
            write(result.files(out))
            _attack(Bench(out, _frames(log), result.trials.seeing, seed), found, each)
        rows = _rows(found)
        if not json:
            _tell(rows)
        done = 0
        while outs and done < hours:
            out, net = outs[done % len(outs)]
            codes += healthy(out, net, seed + 1000 + done, 3600.0, HEALTHY[done % 2])
            done += 1
            if not json:
                print(f"{done} h of other healthy drives: {dict(codes) or 'no code'}", flush=True)
    if json:
        print(json_text.dumps({"seed": seed, "kinds": rows, "hours": done, "codes": dict(codes)}))
    return 0


def _frames(log: Path) -> Frames:
    """Return the frames of a log in order."""
    frames = np.concatenate(list(read_recording(log)))
    return frames[np.argsort(frames["t_ns"], kind="stable")]


def _attack(bench: Bench, found: dict[str, Found], each: int) -> None:
    for kind, mine in found.items():
        if kind in ("forge", FORGED) and not bench.values:
            continue
        before = mine.tried + mine.unwatched
        while mine.tried + mine.unwatched < before + each:
            bench.one(kind, mine)


def _rows(found: dict[str, Found]) -> dict[str, Any]:
    rows: dict[str, Any] = {}
    for kind, mine in found.items():
        times = np.quantile(mine.after_s, (0.5, 0.95)) if mine.after_s else (np.nan, np.nan)
        rows[kind] = vars(mine) | {"after_s": [round(float(s), 3) for s in times]}
    return rows


def _tell(rows: dict[str, Any]) -> None:
    for kind, row in rows.items():
        half, most = row["after_s"]
        print(
            f"{kind}: {row['found']} of {row['tried']} found, {row['soon']} within 1 s, half after {half} s, 95 % after"
            f" {most} s; {row['unwatched']} not watched; by {dict(row['by'])}; others accused: {dict(row['accused'])}",
            flush=True,
        )
