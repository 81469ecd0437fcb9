"""``gateway doctor --bench``: how fast this machine is at what a gateway does, in ten seconds."""

from __future__ import annotations

import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.config.load import load_config
from gateway.faults.records import Changes, Record
from gateway.faults.store import Store, StoreError
from gateway.host.process import processors
from gateway.runtime.app import Gateway
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped

#: How long each of the four is measured [s].
EACH_S = 2.0


def _log() -> Frames:
    """Return frames of a healthy crankshaft."""
    scenario = load_scenario(shipped("scenarios/crank_healthy.toml"))
    return Player(scenario, {"powertrain": 0}).frames


def _gateway() -> Gateway:
    gateway = Gateway(load_config(shipped("gateway.toml")))
    gateway.start(0)
    return gateway


def _times(work: Callable[[int], object], seconds: float, most: int = 1_000_000) -> NDArray[np.float64]:
    """Return how long each call took [s], for a number of seconds, ``most`` calls at most."""
    found: list[float] = []
    ended = time.perf_counter() + seconds
    while (begun := time.perf_counter()) < ended and len(found) < most:
        work(len(found))
        found.append(time.perf_counter() - begun)
    return np.asarray(found)


def _spread(times: NDArray[np.float64]) -> dict[str, float]:
    p50, p99 = np.percentile(times, [50, 99])
    return {"p50_us": float(p50 * 1e6), "p99_us": float(p99 * 1e6), "count": len(times)}


def replay(seconds: float = EACH_S) -> dict[str, float]:
    """Measure a log through the whole gateway of gateway.toml, fault memory in this process; making gateways counts."""
    frames = _log()
    done, spent, ended = 0, 0.0, time.perf_counter() + seconds
    while not done or time.perf_counter() < ended:
        gateway = _gateway()
        gateway.feed(frames[:1])
        begun = time.perf_counter()
        gateway.feed(frames[1:])
        spent += time.perf_counter() - begun
        done += len(frames) - 1
    return {"frames_per_s": done / spent, "us_per_frame": spent / done * 1e6}


def one_frame(seconds: float = EACH_S) -> dict[str, float]:
    """Measure batches of one frame through the same gateway, as a bus with little traffic brings them."""
    frames, gateway = _log(), _gateway()
    gateway.feed(frames[:1])
    pieces = [frames[k : k + 1] for k in range(1, len(frames))]
    return _spread(_times(lambda k: gateway.feed(pieces[k]), seconds, len(pieces)))


def write(folder: Path, seconds: float = EACH_S) -> dict[str, float] | None:
    """Measure how long a change of a DTC takes until it is on the disk; None: nothing can be written there.

    Args:
        folder: where the fault memory is.
        seconds: how long.
    """
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".gateway-bench-") as name:
            store = Store(Path(name) / "faults.sqlite")

            def keep(k: int) -> None:
                record = Record("bench.fault", 0x123456, 0x2E | k & 1, occurrence=1, last_ns=k, evidence={"value": k})
                store.save(Changes(records=[record]))

            try:
                return _spread(_times(keep, seconds))
            finally:
                store.close()
    except (OSError, StoreError):
        return None


def wake(seconds: float = EACH_S) -> dict[str, float]:
    """Measure how long a thread that waits for a socket sleeps on after a frame has come, 1000 times a second."""
    ours, theirs = socket.socketpair()
    stop = threading.Event()

    def send() -> None:
        while not stop.wait(0.001):
            theirs.send(time.perf_counter_ns().to_bytes(8, "little"))

    sender = threading.Thread(target=send, daemon=True)
    ours.settimeout(1.0)
    sender.start()
    found: list[float] = []
    ended = time.perf_counter() + seconds
    try:
        while time.perf_counter() < ended:
            sent = int.from_bytes(ours.recv(8), "little")
            found.append((time.perf_counter_ns() - sent) / 1e9)
    finally:
        stop.set()
        sender.join()
        ours.close()
        theirs.close()
    return _spread(np.asarray(found))


def measure(folder: Path, seconds: float = EACH_S) -> dict[str, Any]:
    """Return what this machine does, by name.

    Args:
        folder: where the fault memory is.
        seconds: for each of the four.
    """
    return {
        "processors": processors(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "replay": replay(seconds),
        "one_frame": one_frame(seconds),
        "wake": wake(seconds),
        "write": {"folder": str(folder), **(write(folder, seconds) or {"count": 0})},
    }


def print_measurements(found: dict[str, Any]) -> None:
    """Print the measurements, and their meaning."""
    one, woken, kept = found["one_frame"], found["wake"], found["write"]
    print(f"{found['processors']} processors, load {found['load']:.1f}: other programs that run count")
    rate = found["replay"]
    print(f"  replay, gateway.toml with four teeth a frame  {rate['us_per_frame']:8.2f} us a frame")
    print(f"                                                {rate['frames_per_s'] / 1e6:8.2f} million frames/s")
    for text, row in (("a frame by itself", one), ("woken by a frame", woken)):
        print(f"  {text:<44}  {row['p50_us']:8.0f} us, 99 %: {row['p99_us']:.0f}")
    if not kept["count"]:
        print(f"  {kept['folder']} cannot be written: DTCs would not be kept there")
        return
    print(f"  {'a DTC on the disk':<44}  {kept['p50_us']:8.0f} us, 99 %: {kept['p99_us']:.0f}")
    total = (one["p50_us"] + woken["p50_us"] + kept["p50_us"]) / 1000
    worst = (one["p99_us"] + woken["p99_us"] + kept["p99_us"]) / 1000
    print(f"  from a frame to its DTC frame: at least {total:.1f} ms, 99 %: {worst:.1f} ms")
    print("a live gateway adds its own work, and two threads' turns: docs/performance.md")


class Speed:
    """The measure of ``gateway doctor --bench``."""

    seconds = 4 * EACH_S
    measure = staticmethod(measure)
    show = staticmethod(print_measurements)
