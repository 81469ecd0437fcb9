"""``gateway evaluate senders``."""

from __future__ import annotations

import json as json_text
import tempfile
from collections import Counter
from dataclasses import replace
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

#: How frames reach the log that is learned of, other healthy drives, and those of a host that is busy.
LEARNED, OTHER = Way(lost=0.01, batch_s=0.004), Way(sleeps=1, late=3, batch_s=0.004)
HOST = replace(OTHER, batch_s=0.1)


def senders(*, cars: int, attacks: int, hours: float, files: tuple[Path, ...], seed: int, json: bool) -> int:
    """Attack virtual cars and logs, replay healthy drives; returns the exit code."""
    found = {kind: Found() for kind in KINDS}
    databases = [path for path in files if path.suffix == ".dbc"]
    logs = [path for path in files if path not in databases]
    codes: Counter[str] = Counter()
    each = -(-attacks // (cars + len(logs)))
    for car in range(cars):
        net = network(seed + car)
        with tempfile.TemporaryDirectory() as folder:
            out, result = learned(Path(folder), net, frames_of(net, seed + car, 300.0, LEARNED))
            _attack(
                Bench(out, frames_of(net, seed + 100 + car, 300.0, OTHER), result.trials.seeing, seed + car),
                found,
                each,
            )
            done = 0.0
            while done < hours / cars:
                way, done = (HOST if done % 2 else OTHER), done + 1.0
                codes += healthy(out, net, seed + 1000 * (car + 1) + int(done), 3600.0, way)
    for log in logs:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "car.toml"
            names = tuple(str(path.resolve()) for path in databases)
            bus = BusAsked("can0", "virtual:can0", names, files=names)
            result = learn(Asked("car", (bus,), (log,), out), lambda *_: None)
            write(result.files(out))
            frames = _frames(log)
            _attack(Bench(out, frames, result.trials.seeing, seed), found, each)
    _tell(found, codes, hours, seed, json=json)
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


def _tell(found: dict[str, Found], codes: Counter[str], hours: float, seed: int, *, json: bool) -> None:
    rows: dict[str, Any] = {}
    for kind, mine in found.items():
        times = np.quantile(mine.after_s, (0.5, 0.95)) if mine.after_s else (np.nan, np.nan)
        rows[kind] = vars(mine) | {"after_s": [round(float(s), 3) for s in times]}
    if json:
        print(json_text.dumps({"seed": seed, "kinds": rows, "hours": hours, "codes": dict(codes)}))
        return
    for kind, row in rows.items():
        print(
            f"{kind}: {row['found']} of {row['tried']} found, {row['soon']} within 1 s, half after"
            f" {row['after_s'][0]} s, 95 % after {row['after_s'][1]} s; {row['unwatched']} not watched;"
            f" by {dict(row['by'])}; others accused: {dict(row['accused'])}"
        )
    print(f"{hours:g} h of other healthy drives: {dict(codes) or 'no code'}")
