"""``gateway warmup``: compile the kernels into the cache."""

from __future__ import annotations

import os
import socket
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from gateway.app import Gateway
from gateway.bus.base import Statistics
from gateway.bus.can_structs import RawReceiver
from gateway.cli.present import print_json
from gateway.config import load_config
from gateway.drive import drive
from gateway.evaluate.structure.analysis import analyse
from gateway.fdi.structure.file import load_model
from gateway.jit import CACHE, cache_is_warm, prune_cache
from gateway.monitors.registry import MONITORS
from gateway.resources import shipped
from gateway.vecu.player import Player
from gateway.vecu.scenario import load_scenario
from gateway.vecu.truck_drive import drive as drive_truck
from gateway.vecu.truck_params import TruckParams

#: Parts that are no monitors.
ENGINE, PLANT, STRUCTURE = "engine", "plant", "structure"


def _compile_engine() -> None:
    """Compile the engine: it reaches monitors by their address, and needs none."""
    scenario = load_scenario(shipped("scenarios/crank_healthy.toml"))
    short = scenario.model_copy(update={"duration_s": 0.1})
    config = load_config(short.config).model_copy(update={"monitor": (), "fault": {}})
    gateway = Gateway(config)
    drive(gateway, Player(short, {bus.name: k for k, bus in enumerate(config.bus)}))
    gateway.close()


def _compile_plant() -> None:
    """Compile the virtual ECUs that are compiled."""
    steering = load_scenario(shipped("scenarios/steering_healthy.toml"))
    Player(steering.model_copy(update={"duration_s": 0.05}), {"chassis": 0})
    drive_truck(TruckParams(type="hybrid_truck"), (), 0.1)


def _compile_structure() -> None:
    """Compile the structural analysis, down to the sequence of a candidate."""
    _ = analyse(load_model(shipped("models/example_1.toml"))).tests


def _compile(part: str) -> None:
    """Compile one part, in a process of its own."""
    if part == ENGINE:
        _compile_engine()
    elif part == PLANT:
        _compile_plant()
    elif part == STRUCTURE:
        _compile_structure()
    else:
        _ = MONITORS[part].entry


def _compile_at_once() -> None:
    """Compile all parts, as many at a time as there are processors."""
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        list(pool.map(_compile, (ENGINE, *MONITORS, PLANT, STRUCTURE)))


def warmup(*, json: bool) -> int:
    """Compile everything that a start needs; returns the exit code."""
    begun = time.monotonic()
    if not cache_is_warm():
        _compile_at_once()
    for monitor in MONITORS.values():
        _ = monitor.entry
    scenario = load_scenario(shipped("scenarios/crank_healthy.toml"))
    short = scenario.model_copy(update={"duration_s": 0.5})
    gateway = Gateway(load_config(short.config))
    drive(gateway, Player(short, {bus.name: k for k, bus in enumerate(gateway.config.bus)}))
    gateway.close()
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
