"""How soon a tester is answered while the monitors work, beside can-isotp's own threaded stack as a server.

Both servers sit on the loopback bus, with 4000 frames/s of four brake pedals on it; the gateway monitors all of
them, the peer only answers. The tester asks one after the other: TesterPresent, DTCs by status mask, an identifier.
A second gateway asks 20 ECUs for 200 identifiers at the same time, at 10 requests/s; a process answers for them.

    python bench/diagnostics.py [--seconds 20] [--rate 4000] [--json]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import platform
import re
import select
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import can
import isotp
import numpy as np

from gateway.bus.frames import empty, put
from gateway.bus.uri import open_bus
from gateway.config.load import load_config
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.isotp.params import IsoTpParams
from gateway.monitors.registry import MONITORS
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped

PEDALS, ECUS, READS = 4, 20, 10
REQUESTS = [bytes.fromhex(text) for text in ("023e00", "031902ff", "0322f186")]
GATEWAY = [sys.executable, "-c", "from gateway.cli import main; main()"]


def write_config(folder: Path) -> Path:
    """Write a gateway with four brake pedals, each a message of its own."""
    dbc = 'VERSION ""\nNS_ :\nBS_:\nBU_: ECU GW\n'
    toml = f'[[bus]]\nname = "b"\nuri = "virtual:b"\ndatabase = ["{folder}/bench.dbc"]\n'
    toml += "[output.uds]\n[output.dtc_frame]\n"
    number = 0
    for k in range(PEDALS):
        dbc += f"BO_ {0x300 + k} P{k}: 8 ECU\n"
        for name, place in (("Crc", "0|8"), ("FrameCnt", "8|4")):
            dbc += f' SG_ {name} : {place}@1+ (1,0) [0|0] "" GW\n'
        for name, at in (("Ch1", 16), ("Ch2", 28)):
            dbc += f' SG_ {name} : {at}|12@1+ (0.001220703125,0) [0|5] "V" GW\n'
        toml += f'[[monitor]]\nname = "p{k}"\ntype = "redundant_pair"\npreset = "brake"\n'
        names = ("FrameCnt", "Ch1", "Ch2")
        renamed = ", ".join(f'"PED_Brake.{name}" = "P{k}.{name}"' for name in names)
        toml += f"signals = {{ {renamed} }}\n"
        for fault in faults_of_a_pair():
            toml += f'[fault."p{k}.{fault}"]\ndtc = "C{0x100 + number:04X}-00"\n'
            number += 1
    (folder / "bench.dbc").write_text(dbc)
    (folder / "bench.toml").write_text(toml)
    layouts = dbc.partition("BO_ ")[0]
    for did in range(READS):
        layouts += f'BO_ {0x80220000 + did} D{did}: 20 ECU\n SG_ Value : 0|16@1+ (1,0) [0|0] "" GW\n'
    (folder / "dids.dbc").write_text(layouts)
    for k in range(ECUS):
        reads = ", ".join(f"{{ did = {did}, every_ms = 20_000 }}" for did in range(READS))
        toml += f'[[ecu]]\nname = "e{k}"\nrequest = {0x600 + k}\nresponse = {0x680 + k}\n'
        toml += f'signals = ["dids.dbc"]\nread = [{reads}]\n'
    (folder / "asks.toml").write_text(toml)
    return folder / "bench.toml"


def ecus(uri: str, ready) -> None:
    """Answer for the ECUs: 20 bytes of each identifier, in four frames."""
    with open_bus(uri, 0) as bus:
        bus.set_filters([0x600 + k for k in range(ECUS)])
        ends = [IsoTpEndpoint(IsoTpParams(request=0x600 + k, response=0x680 + k), 0) for k in range(ECUS)]
        batch = empty(256)
        ready.set()
        while True:
            select.select([bus.fileno()], [], [], 0.5)
            heard = batch[: bus.receive(batch)]
            for end in ends:
                for frame in heard[end.wanted(heard)]:
                    request = end.receive(frame, int(frame["t_ns"]))
                    end.send([] if request is None else [b"\x62" + request.data[1:] + bytes(20)])
                    bus.send(end.take_frames())


def faults_of_a_pair() -> list[str]:
    """Return the names of the faults of a redundant pair."""
    monitor = MONITORS["redundant_pair"]
    return [fault.name for fault in monitor.faults(monitor.params.model_validate({"preset": "brake"}))]


def load_bus(uri: str, rate: int, seconds: float, ready, sent) -> None:
    """Send the pedals' samples in real time, a millisecond's at once."""
    scenario = load_scenario(shipped("scenarios/pedal_healthy.toml"))
    player = Player(scenario, {"chassis": 0})
    samples = player.frames[player.frames["can_id"] == 0x2A0]
    with open_bus(uri, 0) as bus:
        bus.set_filters([0x1FFFFFFF | 0x80000000])
        batch = empty(PEDALS)
        ready.set()
        begun, count = time.monotonic(), 0
        while (now := time.monotonic() - begun) < seconds:
            while count * PEDALS < now * rate:
                sample = samples[count % len(samples)]
                for k in range(PEDALS):
                    put(batch, k, 0, 0x300 + k, sample["data"][:8].tobytes())
                bus.send(batch)
                count += 1
            time.sleep(0.0005)
        sent.value = count * PEDALS


def peer(uri: str, ready) -> None:
    """A server as one would write it: can-isotp's stack, polled."""
    host, port = uri.removeprefix("loopback:").split(":")
    answers = {
        b"\x3e\x00": b"\x7e\x00",
        b"\x19\x02\xff": b"\x59\x02\xff",
        b"\x22\xf1\x86": b"\x62\xf1\x86\x01",
    }
    with can.Bus(interface="socketcand", host=host, port=int(port), channel="can0") as bus:
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E8, rxid=0x7E0)
        stack = isotp.CanStack(bus, address=address)
        stack.start()
        ready.set()
        while True:
            request = stack.recv(block=True, timeout=0.5)
            if request is not None:
                stack.send(answers[bytes(request)])


def ask(uri: str, seconds: float) -> np.ndarray:
    """Ask for so long; returns the times to the first frame of each answer [ms]."""
    times = []
    with open_bus(uri, 0) as bus:
        bus.set_filters([0x7E8])
        batch, one = empty(256), empty(1)
        limit, n = time.monotonic() + seconds, 0
        while time.monotonic() < limit:
            put(one, 0, 0, 0x7E0, REQUESTS[n % len(REQUESTS)].ljust(8, b"\xcc"))
            begun = time.perf_counter()
            bus.send(one)
            answered = False
            while not answered and time.perf_counter() - begun < 2:
                select.select([bus.fileno()], [], [], 0.5)
                got = bus.receive(batch)
                answered = bool((batch[:got]["can_id"] == 0x7E8).any())
            times.append((time.perf_counter() - begun) * 1e3)
            if answered and batch[0]["data"][0] >> 4 == 1:  # the rest is not wanted: overflow
                put(one, 0, 0, 0x7E0, bytes.fromhex("320000cccccccccc"))
                bus.send(one)
            n += 1
            time.sleep(0.005)
    return np.asarray(times)


@contextmanager
def process(*arguments, ready: str, cwd):
    """Start a command of the gateway, wait for a line on stderr."""
    started = subprocess.Popen(
        [*GATEWAY, *map(str, arguments)], stdout=(Path(cwd) / f"{arguments[0]}.out").open("w"), stderr=subprocess.PIPE,
        text=True, cwd=cwd,
    )  # fmt: skip
    try:
        line = ""
        while ready not in line:
            line = started.stderr.readline()
            if not line:
                raise SystemExit(f"{arguments} ended")
        yield line
    finally:
        started.terminate()
        started.wait(20)


def measure(uri: str, rate: int, seconds: float) -> tuple[np.ndarray, int]:
    """Ask while the bus is loaded; returns the times [ms] and the load's frames."""
    ready, sent = multiprocessing.Event(), multiprocessing.Value("q", 0)
    load = multiprocessing.Process(target=load_bus, args=(uri, rate, seconds + 1, ready, sent))
    load.start()
    ready.wait()
    time.sleep(0.5)
    times = ask(uri, seconds)
    load.join()
    return times, sent.value


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=int, default=4000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = write_config(folder)
        load_config(config)
        with process("bus", "127.0.0.1:0", ready="serving", cwd=folder) as line:
            uri = re.search(r"loopback:\S+", line)[0]
            ready = multiprocessing.Event()
            multiprocessing.Process(target=ecus, args=(uri, ready), daemon=True).start()
            ready.wait()
            for title, file in (("gateway, monitoring", config), ("that asks 20 ECUs, too", folder / "asks.toml")):
                daemon = ("run", file, "--bus", uri, "--memory", folder / f"{file.stem}.sqlite")
                with process(*daemon, ready="monitoring", cwd=folder):
                    rows.append((title, *measure(uri, options.rate, options.seconds)))
                summary = (folder / "run.out").read_text()
                decoded = int(re.search(r"(\d+) decoded", summary)[1])
                if decoded < 0.99 * rows[-1][2]:
                    raise SystemExit(f"the gateway decoded {decoded} of {rows[-1][2]} frames")
            asked = dict(re.findall(r"ecu_(\w+) +(\d+)", summary))
            ends = sum(int(asked.get(name, 0)) for name in ("answers", "refused", "absent", "yielded"))
            if int(asked["requests"]) - ends > ECUS:
                raise SystemExit(f"requests without an end: {asked}")
            ready = multiprocessing.Event()
            server = multiprocessing.Process(target=peer, args=(uri, ready), daemon=True)
            server.start()
            ready.wait()
            rows.append(("can-isotp threaded stack", *measure(uri, options.rate, options.seconds)))
            server.terminate()
    base = float(np.percentile(rows[-1][1], 50))
    shown = [
        {
            "name": name,
            "requests": len(times),
            "p50_ms": round(float(np.percentile(times, 50)), 3),
            "p99_ms": round(float(np.percentile(times, 99)), 3),
            "max_ms": round(float(times.max()), 3),
            "over_p2": int((times > 50).sum()),
            "load_frames_per_s": round(frames / (options.seconds + 1)),
            "per_second": round(1e3 / float(np.percentile(times, 50)), 1),
            "ratio": round(base / float(np.percentile(times, 50)), 2),
            "against": rows[-1][0],
        }
        for name, times, frames in rows
    ]
    machine = f"{platform.processor() or platform.machine()}, Python {platform.python_version()}"
    if options.json:
        print(json.dumps({"rows": shown, "machine": machine}, indent=2))
        return
    print(machine)
    for row in shown:
        print(
            f"{row['name']:26} {row['requests']:6} requests  p50 {row['p50_ms']:7.3f} ms"
            f"  p99 {row['p99_ms']:7.3f} ms  max {row['max_ms']:7.3f} ms  over 50 ms: {row['over_p2']}"
            f"  load {row['load_frames_per_s']} frames/s  ratio {row['ratio']}"
        )


if __name__ == "__main__":
    main()
