"""``gateway evaluate senders``."""

from __future__ import annotations

import json as json_text
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import Frames
from gateway.bus.logs import LogReader, open_writer
from gateway_fdi.errors import InputError
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.learn import Asked, learn, write
from gateway_fleet.learn.trial import Seeing
from gateway_fleet.study.learn.drive import Way, frames_of, late_host
from gateway_fleet.study.learn.judge import codes_of, learned
from gateway_fleet.study.learn.network import Network, network
from gateway_fleet.study.senders.attack import FORGED, KINDS, Bench, Found

#: How frames reach the log that is learned of, the drive that is attacked, and other healthy drives: as the bus has
#: them, and by a host that is late.
LEARNED, OTHER = Way(lost=0.01, batch_s=0.004), Way(sleeps=1, late=3, batch_s=0.004)
HEALTHY = (Way(sleeps=1, batch_s=0.004), Way(sleeps=1, batch_s=0.1))


def senders(*, cars: int, attacks: int, hours: float, files: Sequence[Path], seed: int, json: bool) -> int:
    """Attack virtual cars and logs, then replay healthy drives; returns the exit code."""
    found = {kind: Found() for kind in KINDS}
    databases = [path for path in files if path.suffix == ".dbc"]
    logs = [path for path in files if path not in databases]
    if not cars and not logs:
        raise InputError("no virtual car and no log: nothing is attacked", key="--cars", value=cars)
    each = -(-attacks // (cars + bool(logs)))
    codes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as work:
        judged: list[tuple[Path, Callable[[int, Way], Iterable[Frames]]]] = []  # a car: an hour of a seed
        for car in range(cars):
            folder = Path(work) / str(car)
            folder.mkdir()
            net = network(seed + car)
            out, result = learned(folder, net, frames_of(net, seed + car, 300.0, LEARNED))
            judged.append((out, partial(_made, net)))
            other = frames_of(net, seed + 100 + car, 300.0, OTHER)
            _attack(Bench(out, [other], result.trials.seeing, seed + car), found, each)
        if logs:
            out = Path(work) / "log.toml"
            drives, seeing = _of_logs(out, logs, databases)
            judged.append((out, partial(_replays, drives)))
            _attack(Bench(out, drives, seeing, seed), found, each)
        rows = _rows(found)
        if not json:
            _print(rows)
        done = 0
        while judged and done < hours:
            out, hour = judged[done % len(judged)]
            codes += codes_of(out, hour(seed + 1000 + done, HEALTHY[done // len(judged) % 2]))
            done += 1
            if not json:
                print(f"{done} h of other healthy drives: {dict(codes) or 'no code'}", flush=True)
    if json:
        print(json_text.dumps({"seed": seed, "kinds": rows, "hours": done, "codes": dict(codes)}))
    return 0


def _of_logs(out: Path, logs: Sequence[Path], databases: Sequence[Path]) -> tuple[list[Frames], list[Seeing]]:
    """Learn of the first log, of the first half of a log alone; returns the others, and what is seen of the signals."""
    drives = [_frames(log) for log in logs]
    if len(drives) == 1:
        half = (int(drives[0]["t_ns"][0]) + int(drives[0]["t_ns"][-1])) // 2
        drives = np.split(drives[0], np.searchsorted(drives[0]["t_ns"], [half]))
    with open_writer(out.with_suffix(".log")) as writer:
        writer.write(drives[0])
    names = tuple(str(path.resolve()) for path in databases)
    bus = BusAsked("can0", "virtual:can0", names, files=names)
    result = learn(Asked("car", (bus,), (out.with_suffix(".log"),), out), lambda *_: None)
    write(result.files(out))
    return drives[1:], result.trials.seeing


def _frames(log: Path) -> Frames:
    """Return the frames of a log in order."""
    frames = np.concatenate(list(LogReader(log)))
    return frames[np.argsort(frames["t_ns"], kind="stable")]


def _made(net: Network, seed: int, way: Way) -> Iterator[Frames]:
    yield frames_of(net, seed, 3600.0, way)


def _replays(drives: Sequence[Frames], seed: int, way: Way) -> Iterator[Frames]:
    """Yield an hour of the same drives again and again, each time with other lateness of the host."""
    seconds, rng = 0.0, np.random.default_rng([seed, 3])
    while seconds < 3600.0:
        for drive in drives:
            yield late_host(drive, way.batch_s, int(rng.integers(1 << 40)))
            seconds += float(drive["t_ns"][-1] - drive["t_ns"][0]) * 1e-9


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


def _print(rows: dict[str, Any]) -> None:
    for kind, row in rows.items():
        half, most = row["after_s"]
        print(
            f"{kind}: {row['found']} of {row['tried']} found, {row['soon']} within 1 s, half after {half} s, 95 % after"
            f" {most} s; {row['unwatched']} not watched; by {dict(row['by'])}; others accused: {dict(row['accused'])}",
            *row["missed"],
            sep="\n  ",
            flush=True,
        )
