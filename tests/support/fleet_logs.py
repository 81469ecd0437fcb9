"""Logs of a fleet that are generated, and a configuration for them: one message, its supervision, a range."""

import hashlib
import json

import numpy as np
import own_message

from gateway.bus.frames import empty
from gateway.bus.logs import open_writer
from gateway_fleet.fleet.verdicts import TABLES, Verdicts

DBC = f"""{own_message.DBC}\
 SG_ Speed : 16|16@1+ (0.01,0) [0|655] "km/h" B
"""
CONFIG = """
[clock]
watched = false

[[bus]]
name = "chassis"
uri = "virtual:chassis"
database = ["car.dbc"]
health = {{ watched = false }}

[[bus.check]]
message = "M0"
timeout_ms = 100.0

[[monitor]]
name = "voltage"
bus = "chassis"
type = "signal"
signal = [{{ signal = "M0.Value", plausible = [0, {high}], code = "C0070" }}]

[usage]
speed = "M0.Speed"
"""


def write_config(folder, high=1000.0, name="car.toml"):
    """Write the configuration; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "car.dbc").write_text(DBC)
    path = folder / name
    path.write_text(CONFIG.format(high=high))
    return path


def write_log(path, *, seed, frames=1000, peak=None, silence=None, begin_s=1_700_000_000):
    """Write a log: the value goes up to ``peak`` [V] and down again, with a silence of a second at a frame.

    Returns:
        the path.
    """
    rng = np.random.default_rng(seed)
    batch = empty(frames)
    peak = float(rng.uniform(500, 900)) if peak is None else peak
    index = np.arange(frames)
    batch["t_ns"] = begin_s * 10**9 + index * 10_000_000
    if silence is not None:
        batch["t_ns"][silence:] += 10**9
    batch["can_id"], batch["length"] = 256, 8
    raw = (2 * peak * np.sin(np.pi * index / frames)).astype("<u2")
    batch["data"][:, 0:2] = raw.view(np.uint8).reshape(-1, 2)
    batch["data"][:, 2:4] = np.full(frames, 3600, "<u2").view(np.uint8).reshape(-1, 2)
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_writer(path) as writer:
        writer.write(batch)
    return path


def write_fleet(folder, count, *, frames=1000, devices=5):
    """Write so many logs: of each ten one is out of range, one silent for a second; returns their paths."""
    return [
        write_log(
            folder / f"car{k % devices}" / f"{k:05d}.log",
            seed=k,
            frames=frames,
            peak=1200.0 if k % 10 == 3 else None,
            silence=frames // 2 if k % 10 == 7 else None,
            begin_s=1_700_000_000 + 3600 * k,
        )
        for k in range(count)
    ]


def tables_hash(out, *, but=()):
    """Return a hash of all rows of all tables, without those of some tables."""
    total = hashlib.sha256()
    for table in TABLES:
        if table not in but:
            rows = Verdicts(out).rows(table)
            total.update(json.dumps([table, *sorted(rows, key=json.dumps)]).encode())
    return total.hexdigest()
