"""``gateway warmup``: compile the kernels into the cache."""

from __future__ import annotations

import time

from gateway.app import Gateway
from gateway.bus.frames import empty
from gateway.cli.present import print_json
from gateway.config import load_config
from gateway.jit import CACHE, prune_cache
from gateway.monitors.registry import MONITORS
from gateway.resources import shipped


def warmup(*, json: bool) -> int:
    """Compile everything that a start needs; returns the exit code."""
    begun = time.monotonic()
    for monitor in MONITORS.values():
        _ = monitor.entry
    gateway = Gateway(load_config(shipped("gateway.toml")))
    frames = empty(2)
    frames[1]["t_ns"] = 10**9
    gateway.start(0)
    gateway.feed(frames)
    gateway.advance(2 * 10**9)
    gateway.stop(2 * 10**9)
    gateway.close()
    prune_cache()
    seconds = time.monotonic() - begun
    if json:
        print_json({"seconds": seconds, "cache": str(CACHE)})
    else:
        print(f"kernels ready in {seconds:.1f} s: {CACHE}")
    return 0
