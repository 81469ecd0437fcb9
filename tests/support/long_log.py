"""Logs that are as long as one likes, a worker that judges them, and the most memory that it has had."""

import gzip
import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil

#: Frames that are generated at a time.
BLOCK = 1_000_000
#: Dask's profiler keeps 50 kB of each second that a worker works (docs/fleet.md).
QUIET = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}
LINE = b"(1700000000.000000000) chassis 100#0000100E00000000\n"


def _digits(numbers, count, base=10):
    """Return numbers as characters, shape (n, count)."""
    powers = base ** np.arange(count - 1, -1, -1)
    found = (numbers[:, None] // powers) % base
    return (found + np.where(found < 10, 48, 55)).astype(np.uint8)


def lines(frames, every):
    """Yield a log's lines, many at a time."""
    for first in range(0, frames, BLOCK):
        index = np.arange(first, min(first + BLOCK, frames))
        text = np.tile(np.frombuffer(LINE, np.uint8), (len(index), 1))
        t_ns = index * 10_000_000
        text[:, 1:11] = _digits(1_700_000_000 + t_ns // 10**9, 10)
        text[:, 12:21] = _digits(t_ns % 10**9, 9)
        value = np.where(index % every < 50, 2400, 1000 + index % 97)  # of half a volt; the limit is 1000 V
        text[:, 35:37] = _digits(value % 256, 2, 16)
        text[:, 37:39] = _digits(value // 256, 2, 16)
        yield text.tobytes()


def generate(path, frames, every):
    """Write a log of one message, 10 ms apart, out of range once in so many frames; returns its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with gzip.open(path, "wb", compresslevel=1) if path.suffix == ".gz" else path.open("wb") as file:
        for part in lines(frames, every):
            file.write(part)
    return path


@contextmanager
def one_worker(folder):
    """Start a scheduler and a worker on loopback; yields the scheduler's address and the worker's process."""
    facts = folder / "scheduler.json"
    common = ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(facts)]
    with (folder / "dask.out").open("w") as out:
        dask = [sys.executable, "-m", "dask"]
        parts = [subprocess.Popen([*dask, "scheduler", "--port", "0", *common], stdout=out, stderr=out)]
        try:
            while not facts.exists() or not facts.read_text().strip():
                time.sleep(0.1)
            words = ["worker", "--nthreads", "1", "--no-nanny", "--memory-limit", "0", *common]
            parts.append(subprocess.Popen([*dask, *words], stdout=out, stderr=out, env=os.environ | QUIET))
            yield json.loads(facts.read_text())["address"], psutil.Process(parts[1].pid)
        finally:
            for part in reversed(parts):
                part.terminate()
                part.wait()


def greatest(process):
    """Return the greatest resident memory that a process has had [byte]."""
    text = Path(f"/proc/{process.pid}/status").read_text()
    return next(int(line.split()[1]) * 1024 for line in text.splitlines() if line.startswith("VmHWM"))
