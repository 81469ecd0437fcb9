"""How even a rest bus in real time is: 500 messages in their cycles, beside python-can's cyclic tasks on the same bus.

Both send over ``gateway bus`` (or ``--uri socketcan:vcan0``) to a receiver in a process of its own, which notes when
each frame came: how far is the time between two frames of a message from its cycle?

    python bench/restbus.py [--messages 500] [--seconds 10] [--uri URI] [--priority 10] [--without-peer] [--json]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import re
import select
import subprocess
import sys
import tempfile
import threading
import time
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path

import can
import numpy as np

from gateway.bus.frames import empty
from gateway.bus.uri import open_bus
from gateway.config.load import load_config
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.expectations import Judge
from gateway_bench.vecu.scenario import load_scenario

#: Cycle times [ms], and how many of a hundred messages have each.
CYCLES = ((10, 2), (20, 6), (50, 12), (100, 30), (200, 20), (500, 15), (1000, 15))
FIRST_ID = 0x100


def cycles(count: int) -> list[int]:
    """Return the cycle of each message [ms]."""
    hundred = [cycle for cycle, share in CYCLES for _ in range(share)]
    return [hundred[k * 37 % 100] for k in range(count)]


def write(folder: Path, count: int, seconds: float, uri: str) -> Path:
    """Write database, configuration and scenario; returns the scenario's path."""
    dbc = 'VERSION ""\nBU_: A\n'
    for k in range(count):
        dbc += f'BO_ {FIRST_ID + k} M{k}: 8 A\n SG_ COUNTER : 0|4@1+ (1,0) [0|15] "" A\n'
        dbc += ' SG_ A : 8|16@1+ (1,0) [0|65535] "" A\n SG_ B : 24|16@1- (0.1,0) [-3000|3000] "" A\n'
    dbc += 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\n'
    dbc += "".join(f'BA_ "GenMsgCycleTime" BO_ {FIRST_ID + k} {cycle};\n' for k, cycle in enumerate(cycles(count)))
    (folder / "rest.dbc").write_text(dbc)
    config = f'[[bus]]\nname = "b"\nuri = "{uri}"\ndatabase = ["rest.dbc"]\n[output.dtc_frame]\n'
    (folder / "gateway.toml").write_text(config)
    path = folder / "rest.toml"
    path.write_text(
        f'name = "rest"\nduration_s = {seconds}\nconfig = "gateway.toml"\n[[ecu]]\ntype = "restbus"\n'
        '[ecu.signals]\n"M0.B" = { sine = { amplitude = 100, period_s = 2 } }\n'
    )
    return path


def receive(uri: str, pipe: Connection, priority: int | None) -> None:
    """Note identifier and time of each frame until told to end."""
    import_module("gateway_bench.cli.simulate").prefer(priority)
    batch, ids, times = empty(1024), [], []
    with open_bus(uri) as bus:
        pipe.send("ready")
        while not pipe.poll():
            if select.select([bus.fileno()], [], [], 0.05)[0]:
                count = len(batch)
                while count == len(batch):
                    count = bus.receive(batch)
                    now = time.monotonic_ns()
                    ids.append(batch["can_id"][:count].copy())
                    times.append(np.full(count, now))
    pipe.send((np.concatenate(ids), np.concatenate(times)))


def jitter(ids: np.ndarray, times: np.ndarray, count: int) -> np.ndarray:
    """Return how far each frame was from a cycle after the one before [ms]."""
    found = []
    for k, cycle in enumerate(cycles(count)):
        mine = times[ids == FIRST_ID + k].astype(np.float64) * 1e-6
        if len(mine) > 1:
            found.append(np.abs(np.diff(mine) - cycle))
    return np.concatenate(found)


def ours(scenario: Path, uri: str, priority: int | None) -> None:
    """Play the rest bus, as ``gateway simulate`` does."""
    simulate = import_module("gateway_bench.cli.simulate")
    loaded = load_scenario(scenario)
    player = player_of(loaded, load_config(loaded.config))
    simulate.prefer(priority)
    with open_bus(uri) as bus:
        tester = simulate._Tester([bus], Judge(loaded))
        simulate._play(player, [bus], tester, None, lambda: False, patient=False)


def theirs(count: int, seconds: float, uri: str, priority: int | None) -> None:
    """Let python-can send the same messages, each by its cyclic task."""
    import_module("gateway_bench.cli.simulate").prefer(priority)
    if uri.startswith("loopback:"):
        host, _, port = uri.removeprefix("loopback:").rpartition(":")
        bus = can.Bus(interface="socketcand", host=host, port=int(port), channel="can0")
    else:
        bus = can.Bus(interface="socketcan", channel=uri.partition(":")[2])
    with bus:
        tasks, lock = [], threading.Lock()
        for k, cycle in enumerate(cycles(count)):
            message = can.Message(arbitration_id=FIRST_ID + k, data=bytes(8), is_extended_id=False)
            # On SocketCAN the kernel sends; what is compared is what python-can does itself.
            task = can.broadcastmanager.ThreadBasedCyclicSendTask(bus, lock, [message], cycle * 1e-3)
            tasks.append(task)
        time.sleep(seconds)
        for task in tasks:
            task.stop()


def measured(uri: str, work: object, arguments: tuple, count: int) -> dict[str, float]:
    """Return the jitter of what a process sends."""
    here, there = multiprocessing.Pipe()
    listener = multiprocessing.Process(target=receive, args=(uri, there, arguments[-1]))
    listener.start()
    assert here.recv() == "ready"
    sender = multiprocessing.Process(target=work, args=arguments)
    sender.start()
    sender.join()
    time.sleep(0.3)
    here.send("end")
    ids, times = here.recv()
    listener.join()
    off = jitter(ids, times, count)
    p50, p99, p999 = np.percentile(off, [50, 99, 99.9])
    return {"frames": len(ids), "p50_ms": p50, "p99_ms": p99, "p99.9_ms": p999, "max_ms": off.max()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--messages", type=int, default=500)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--uri")
    parser.add_argument("--without-peer", action="store_true")
    parser.add_argument("--priority", type=int, help="SCHED_RR, of all processes of the bench")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    wanted = sum(options.seconds * 1e3 / cycle for cycle in cycles(options.messages))
    hub = None
    try:
        uri = options.uri
        if uri is None:
            command = [sys.executable, "-c", "from gateway.cli import main; main()", "bus", "127.0.0.1:0"]
            import_module("gateway_bench.cli.simulate").prefer(options.priority)  # of the bus, too
            hub = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
            uri = re.search(r"loopback:\S+", hub.stderr.readline())[0]
        with tempfile.TemporaryDirectory() as folder:
            scenario = write(Path(folder), options.messages, options.seconds, uri)
            found = {"rest bus": measured(uri, ours, (scenario, uri, options.priority), options.messages)}
            if not options.without_peer:
                arguments = options.messages, options.seconds, uri, options.priority
                found["python-can, a thread a message"] = measured(uri, theirs, arguments, options.messages)
    finally:
        if hub is not None:
            hub.terminate()
            hub.wait()
    load = os.getloadavg()[0]
    if options.json:
        print(json.dumps({"wanted": wanted, "load": load, "found": found}))
        return
    rate = wanted / options.seconds
    print(f"{options.messages} messages, {rate:.0f} frames/s, {options.seconds:g} s, {uri.partition(':')[0]};", end=" ")
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {load:.1f}")
    print(f"{'':32}{'frames':>10}{'of wanted':>11}{'p50':>9}{'p99':>9}{'p99.9':>9}{'max':>9}  [ms off its cycle]")
    for name, one in found.items():
        share = one["frames"] / wanted
        numbers = "".join(f"{one[key]:9.2f}" for key in ("p50_ms", "p99_ms", "p99.9_ms", "max_ms"))
        print(f"{name:32}{one['frames']:10.0f}{share:11.1%}{numbers}")


if __name__ == "__main__":
    main()
