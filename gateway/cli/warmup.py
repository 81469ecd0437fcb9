"""``gateway warmup``: compile the kernels into the cache."""

from __future__ import annotations

import socket
import time

from gateway.app import Gateway
from gateway.bus.base import Statistics
from gateway.bus.can_structs import RawReceiver
from gateway.cli.present import print_json
from gateway.config import load_config
from gateway.drive import drive
from gateway.jit import CACHE, prune_cache
from gateway.monitors.registry import MONITORS
from gateway.resources import shipped
from gateway.vecu.player import Player
from gateway.vecu.scenario import load_scenario


def warmup(*, json: bool) -> int:
    """Compile everything that a start needs; returns the exit code."""
    begun = time.monotonic()
    for monitor in MONITORS.values():
        _ = monitor.entry
    scenario = load_scenario(shipped("scenarios/crank_healthy.toml"))
    short = scenario.model_copy(update={"duration_s": 0.5})
    gateway = Gateway(load_config(short.config))
    drive(gateway, Player(short, {bus.name: k for k, bus in enumerate(gateway.config.bus)}))
    gateway.close()
    steering = load_scenario(shipped("scenarios/steering_healthy.toml"))
    Player(steering.model_copy(update={"duration_s": 0.05}), {"chassis": 0})
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        RawReceiver(ours, Statistics())
    prune_cache()
    seconds = time.monotonic() - begun
    if json:
        print_json({"seconds": seconds, "cache": str(CACHE)})
    else:
        print(f"kernels ready in {seconds:.1f} s: {CACHE}")
    return 0
