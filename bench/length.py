"""What a worker takes of the memory by the length of a log.

    python bench/length.py [--frames 1e6 1e7 1e8] [--every 1e5] [--format log] [--folder DIR] [--json]

For each length a log of one message is generated, 10 ms apart, whose value is out of range once in ``--every``
frames; a scheduler and a worker are started as processes of their own (``dask scheduler``, ``dask worker``) and judge
it as ``gateway fleet run`` does. The worker's greatest resident memory is what the kernel says of its process (VmHWM);
it has judged a short log before, so that all is loaded. A log of 10^8 frames as candump takes 5 GB in the folder, and
is deleted.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))

import psutil
from fleet_logs import write_config, write_log
from long_log import generate, greatest, one_worker

from gateway_fleet.fleet.run import Order, run
from gateway_fleet.fleet.verdicts import Verdicts
from gateway_logs.corpus import find


def quarters(process: psutil.Process, stop: threading.Event, into: list[int]) -> None:
    """Sample a process's resident memory until told to stop; then keep the greatest of each quarter of the time."""
    samples = []
    while not stop.wait(0.1):
        samples.append(process.memory_info().rss)
    into += [int(max(part)) for part in np.array_split(np.array(samples), 4) if len(part)]


def measure(folder: Path, frames: int, every: int, suffix: str) -> dict[str, Any]:
    """Have a worker judge a log of so many frames; returns what it took."""
    config = write_config(folder)
    short = write_log(folder / "logs" / "short.log", seed=1, frames=1000)
    path = folder / "logs" / f"long.{suffix}"
    generate(path, frames, every)
    with one_worker(folder) as (address, worker):
        run(Order(find([short]), config, folder / "out", scheduler=address))
        before = greatest(worker)
        stop, resident = threading.Event(), []
        sampler = threading.Thread(target=quarters, args=(worker, stop, resident))
        sampler.start()
        begun = time.perf_counter()
        (outcome,) = run(Order(find([path]), config, folder / "out", scheduler=address)).outcomes
        seconds = time.perf_counter() - begun
        stop.set()
        sampler.join()
        after = greatest(worker)
    assert (outcome.state, outcome.frames) == ("whole", frames), outcome
    events = len(Verdicts(folder / "out").rows("events", outcome.log))
    return {"frames": frames, "log_bytes": path.stat().st_size, "events": events, "short_bytes": before,
            "greatest_bytes": after, "quarters_bytes": resident, "seconds": seconds}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=float, nargs="+", default=[1e6, 1e7, 1e8])
    parser.add_argument("--every", type=float, default=1e5)
    parser.add_argument("--format", choices=["log", "log.gz"], default="log")
    parser.add_argument("--folder", type=Path, help="where the logs are put for the time being")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if not options.json:
        print("| frames | log [MB] | events | worker before [MB] | greatest [MB] | in quarters [MB] | frames/s |")
        print("|---|---|---|---|---|---|---|")
    for frames in options.frames:
        with tempfile.TemporaryDirectory(dir=options.folder) as folder:
            row = measure(Path(folder), int(frames), int(options.every), options.format)
        if options.json:
            print(json.dumps(row), flush=True)
            continue
        before, after, size = (f"{row[name] / 1e6:,.0f}" for name in ("short_bytes", "greatest_bytes", "log_bytes"))
        resident = ", ".join(f"{one / 1e6:.0f}" for one in row["quarters_bytes"])
        rate = f"{row['frames'] / row['seconds']:,.0f}"
        cells = [f"{row['frames']:,}", size, str(row["events"]), before, after, resident, rate]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
