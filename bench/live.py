"""The live daemon beside a loop of python-can's Notifier and cantools: frames without loss, and how long a DTC takes.

Both get the same frames from a process of their own, as ``struct can_frame``: over a unix socket that stands in for the
raw socket, or (``--interface vcan0``) over SocketCAN. 16 messages with alive counter and CRC, each frame checked and
decoded. Every 20 ms one frame has a wrong CRC: a DTC frame must follow, and the next good frame heals it.

    python bench/live.py [--rates 4000 80000] [--seconds 4] [--only durable sustained ...] [--interface vcan0]
                         [--buses 1 8] [--parts] [--json]

Each figure is told when it is measured; all take less than two minutes, of which the sustained rates take half.
``--parts`` shows where a verdict's time goes, beside what the disk takes to keep one block that was there before.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import platform
import select
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import can
import cantools
import crccheck
import numpy as np
from can.interfaces.socketcan.socketcan import build_can_frame, capture_message

from gateway.bus.base import Bus
from gateway.bus.can_structs import RawReceiver
from gateway.bus.socketcan import SocketCanBus
from gateway.bus.uri import open_bus
from gateway.config.load import load_config
from gateway.faults.memory import FaultMemory
from gateway.faults.resilient_store import ResilientStore
from gateway.live.link import Link
from gateway.live.loop import Live
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped

sys.path.append(str(Path(__file__).parent))  # tests import this file from elsewhere

from live_sender import BASE, DTC_ID, EVERY_S, MESSAGES, datagrams, send_at

sys.path.remove(str(Path(__file__).parent))  # names of this folder are names of theirs, too

#: The sustained rate is sought from here, and not below there [frames/s].
FIRST_RATE, LEAST_RATE = 64_000.0, 250.0
#: Receive buffer, as ``rcvbuf`` of a SocketCAN URI: what is lost is lost when this is full.
BUFFER = 4 << 20

MESSAGE = """BO_ {id} M{k}: 8 Ecu
 SG_ Crc : 0|8@1+ (1,0) [0|255] "" Gateway
 SG_ FrameCnt : 8|8@1+ (1,0) [0|255] "" Gateway
 SG_ A : 16|16@1+ (0.1,0) [0|6553] "V" Gateway
 SG_ B : 32|16@1- (0.01,0) [-300|300] "A" Gateway
 SG_ C : 48|16@1+ (1,0) [0|65535] "rpm" Gateway
"""


def write_config(folder: Path, buses: int = 1) -> Path:
    """Write the configuration of the gateway; message k is on bus k modulo the buses."""
    dbc = 'VERSION ""\nNS_ :\nBS_:\nBU_: Ecu Gateway\n'
    toml, names = 'name = "live"\n', ["b", *(f"b{k}" for k in range(1, buses))]
    faults = ""
    for k in sorted(range(MESSAGES), key=lambda k: k % buses):
        bus, dbc = names[k % buses], dbc + MESSAGE.format(id=BASE + k, k=k)
        if k < buses:
            toml += f'[[bus]]\nname = "{bus}"\nuri = "virtual:{bus}"\ndatabase = ["live.dbc"]\n'
        toml += f'[[bus.check]]\nmessage = "M{k}"\ntimeout_ms = 60000.0\n'
        toml += f'counter = {{ signal = "FrameCnt" }}\ncrc = {{ signal = "Crc", data_id = {k} }}\n'
        for j, name in enumerate(("timeout", "counter", "crc", "length", "rule")):
            faults += f'[fault."{bus}.M{k}.{name}"]\ndtc = "U1{j}{k:02X}-00"\nfreeze_frame = ["{bus}.M{k}.A"]\n'
        faults += f'[fault."{bus}.M{k}.crc".debounce]\n'
        faults += "failed_after = 1\npassed_after = 1\njump_down = true\n"
    toml += faults + '[output.dtc_frame]\nbus = "b"\nmin_interval_ms = 0\ncycle_ms = 1000.0\n'
    (folder / "live.dbc").write_text(dbc)
    (folder / "live.toml").write_text(toml)
    return folder / "live.toml"


class StructBus(SocketCanBus):
    """What SocketCanBus does, on another datagram socket."""

    def __init__(self, sock: socket.socket, index: int) -> None:
        Bus.__init__(self, "test:live", index)
        self._gone = None
        self._socket = sock
        sock.setblocking(False)
        self._receiver = RawReceiver(sock, self.statistics)

    def set_filters(self, can_ids: object) -> None:
        """Take all."""


#: What becomes of a verdict in the fault memory's file, in order, beside the way of its DTC frame through the journal.
PARTS = (
    "frame received, judged, entered",
    "handed to the thread that writes",
    "transaction: SQLite, its log synchronised",
    "the loop goes on",
)
#: Syncs of one block, to compare with.
SYNCS = 256


class Marks:
    """When a verdict was where; one that is under way at a time."""

    def __init__(self) -> None:
        self.rows: list[list[float]] = []
        self._put_before(FaultMemory, "begin", 0)
        self._put_before(ResilientStore, "save", 1)
        self._put_after(ResilientStore, "save", 2)
        self._put_before(FaultMemory, "join", 3)

    def _mark(self, place: int) -> None:
        if place == 0:
            self.rows.append([])
        if self.rows and len(self.rows[-1]) == place:
            self.rows[-1].append(time.perf_counter())

    def _put_before(self, kind: type, name: str, place: int) -> None:
        inner = getattr(kind, name)

        def marked(*args: object, **more: object) -> object:
            self._mark(place)
            return inner(*args, **more)

        setattr(kind, name, marked)

    def _put_after(self, kind: type, name: str, place: int) -> None:
        inner: Callable[..., object] = getattr(kind, name)

        def marked(*args: object, **more: object) -> object:
            made = inner(*args, **more)
            self._mark(place)
            return made

        setattr(kind, name, marked)


def sync_times(folder: Path) -> list[float]:
    """Return how long the disk takes to keep a block that was there before, again and again [ms]."""
    times = []
    file = os.open(folder / "block", os.O_RDWR | os.O_CREAT)
    os.write(file, bytes(4096))
    os.fsync(file)
    for k in range(SYNCS):
        time.sleep(0.004)
        begun = time.perf_counter()
        os.pwrite(file, bytes([k % 256]) * 4096, 0)
        os.fdatasync(file)
        times.append((time.perf_counter() - begun) * 1e3)
    os.close(file)
    return times


def compute(end):
    """Compute in Python until the end."""
    while not end.is_set():
        sum(range(10_000))


def our_side(
    opener: Any,
    config: Path,
    memory: Path | None,
    ready: Any,
    end: Any,
    out: Any,
    *,
    parts: bool = False,
    beside: bool = False,
    realtime: bool = False,
) -> None:
    """Run the gateway's live loop in this process; ``beside`` it a thread that never lets go of the interpreter.

    The opener gets the number of a bus. ``realtime``: as ``gateway run --realtime`` does.
    """
    marks = Marks() if parts else None
    syncs = sync_times(config.parent) if parts else []
    gateway = Gateway(load_config(config), memory)
    gateway.write_beside()
    from gateway.live.clock import Clock  # noqa: PLC0415 - storm.py uses this file with earlier gateways

    clock = Clock()
    links = [Link("test:live", k, bus.name, opener, clock) for k, bus in enumerate(gateway.config.bus)]
    for link in links:
        link.start()
    gateway.start(time.time_ns())
    live = Live(gateway, links, lambda event: None, clock=clock)
    for _ in range(20):
        live.turn()
    ready.set()
    if beside:
        threading.Thread(target=compute, args=(end,), daemon=True).start()
    begun_ns = time.thread_time_ns()
    with ExitStack() as stack:
        if realtime:
            from gateway.host.slice import real_time  # noqa: PLC0415 - earlier gateways have none

            if not stack.enter_context(real_time()):
                raise SystemExit("real time is root's, or his who has LimitRTPRIO=1")
        live.run(end.is_set)
    for _ in range(5):
        live.turn()
    cpu_us = (time.thread_time_ns() - begun_ns) / 1e3
    found = {"decoded": gateway.engine.counters()["decoded"], "syncs": syncs}
    found["lost"] = sum(link.statistics.overflow for link in links)
    found["cpu_us"] = cpu_us / max(found["decoded"], 1)
    out.put(found | {"marks": marks.rows if marks else []})
    for link in links:
        link.close()
    gateway.close()


class StructCan(can.BusABC):
    """python-can's SocketCAN code on another datagram socket."""

    def __init__(self, sock: socket.socket) -> None:
        self.socket = sock
        sock.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
        super().__init__(channel="live")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if select.select([self.socket], [], [], timeout)[0]:
            return capture_message(self.socket), False
        return None, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send as python-can packs it."""
        self.socket.send(build_can_frame(msg))


def their_side(opener: Any, config: Path, memory: Any, ready: Any, end: Any, out: Any) -> None:
    """What one writes with the libraries: a Notifier, a listener that checks, decodes and sends."""
    database = cantools.database.load_file(config.with_suffix(".dbc"))
    by_id = {message.frame_id: message for message in database.messages}
    dtc = cantools.database.load_file(shipped("dbc/gateway.dbc")).get_message_by_name("GW_DTC")
    last, failing = {}, {}
    decoded = 0
    bus = opener()

    def listen(message: can.Message) -> None:
        nonlocal decoded
        known = by_id.get(message.arbitration_id)
        if known is None:
            return
        k = message.arbitration_id - BASE
        data = bytes(message.data)
        wrong = crccheck.crc.Crc8SaeJ1850.calc(data[1:] + k.to_bytes(2, "little")) != data[0]
        if wrong != failing.get(k, False):
            failing[k] = wrong
            values = {signal.name: 0 for signal in dtc.signals}
            values |= {"Dtc": 0xD20000 | k << 8, "Status": 0x2F if wrong else 0x2E}
            bus.send(can.Message(arbitration_id=DTC_ID, is_extended_id=False, data=dtc.encode(values)))
        if wrong:
            return
        values = known.decode(data, decode_choices=False)
        if k in last and (values["FrameCnt"] - last[k]) % 256 != 1:
            failing[k, "counter"] = True
        last[k] = values["FrameCnt"]
        decoded += 1

    notifier = can.Notifier(bus, [listen], timeout=0.1)
    ready.set()
    end.wait()
    time.sleep(1.0)
    notifier.stop()
    out.put({"decoded": decoded, "lost": 0, "cpu_us": time.process_time_ns() / 1e3 / max(decoded, 1)})
    bus.shutdown()


def parts_of(found: dict) -> list[dict]:
    """Return the DTC frames' times, and the parts of the verdicts' way into the file [ms]."""
    rows = []
    for asked, _ in found["spans"]:
        marks = [row for row in found["marks"] if len(row) == len(PARTS) and asked < row[0] < asked + EVERY_S / 2]
        if marks:  # the first write after it; the fault heals after some ms
            rows.append(np.diff([asked, *marks[0]]) * 1e3)
    if not rows:
        return []
    table = np.asarray(rows)
    named = [("frame to DTC frame, by the journal", np.asarray(found["times"]))]
    named += [("beside: fdatasync of a block that was there", np.asarray(found["syncs"]))]
    named += [*zip(PARTS, table.T, strict=True), ("all: in the fault memory's file", table.sum(axis=1))]
    return [
        {
            "part": name,
            "verdicts": len(values),
            "p50_ms": round(float(np.percentile(values, 50)), 3),
            "p99_ms": round(float(np.percentile(values, 99)), 3),
        }
        for name, values in named
    ]


def pairs(count: int) -> tuple[list[socket.socket], list[socket.socket]]:
    """Return both ends of sockets that keep datagrams apart."""
    made = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(count)]
    for sock in (each for pair in made for each in pair):
        try:
            sock.setsockopt(socket.SOL_SOCKET, 32, BUFFER)  # SO_SNDBUFFORCE
        except PermissionError:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
    return [ours for ours, _ in made], [theirs for _, theirs in made]


def measure(
    side: Any, interface: str | None, memory: bool, rate: float, seconds: float, buses: int = 0, rest_s: float = 0
) -> dict:
    """Run one receiver at one rate; with a number of buses, frames without faults on so many of them."""
    context = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory() as name:
        config, more = write_config(Path(name), max(buses, 1)), []
        if interface is None:
            ours, (theirs, *more) = pairs(max(buses, 1))
            theirs_opens = partial(StructCan, ours[0])
            opener = (
                theirs_opens if side in (their_side, least_side) else lambda uri, index: StructBus(ours[index], index)
            )
        else:
            theirs = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            theirs.bind((interface,))
            opener = (
                partial(can.Bus, interface, interface="socketcan")
                if side is their_side
                else lambda uri, index: open_bus(f"socketcan:{interface}", index)
            )
        ready, end, out = context.Event(), context.Event(), context.Queue()
        path = Path(name) / "f.sqlite" if memory else None
        child = context.Process(target=side, args=(opener, config, path, ready, end, out))
        child.start()
        if not ready.wait(300):
            raise SystemExit("the receiver did not start")
        from gateway.host.slice import short_slices  # noqa: PLC0415 - earlier gateways have none

        with short_slices():  # where it shares a core with the receiver, it sees a frame soon after it has come
            found = send_at(theirs, rate, seconds, datagrams(), more, math.inf if buses else EVERY_S, rest_s)
        end.set()
        found |= out.get(timeout=60)
        child.join(20)
        for sock in (theirs, *more):
            sock.close()
    wrong = len(found["times"]) + 1
    found["missing"] = max(found["sent"] - found["full"] - found["decoded"] - wrong, 0)
    found["lost_all"] = found["full"] + found["lost"] + found["missing"]
    return found


def sustained(side: Any, interface: str | None, memory: bool, seconds: float) -> float:
    """Return a rate at which no frame is lost, an eighth at most below one at which some are [frames/s]."""

    def reached(rate: float) -> float:
        found = measure(side, interface, memory, rate, seconds)
        done = found["sent"] / seconds
        return 0.0 if found["lost_all"] or done < 0.9 * rate else done

    rate, bad = FIRST_RATE, math.inf
    while not (best := reached(rate)):
        bad, rate = rate, rate / 4
        if rate < LEAST_RATE:
            return 0.0
    good = rate
    while bad > 1.125 * good:
        middle = 2 * good if bad == math.inf else (good + bad) / 2
        if done := reached(middle):
            good, best = middle, done
        else:
            bad = middle
    return best


def show_parts(options: argparse.Namespace) -> None:
    """Print where a verdict's time goes at each rate."""
    tables = {}
    for rate in options.rates:
        found = measure(partial(our_side, parts=True), options.interface, True, rate, options.seconds)
        tables[rate] = parts_of(found)
        if not options.json:
            print(f"{f'at {rate} frames/s, ms':46}{'p50':>8}{'p99':>8}{'verdicts':>10}")
            for row in tables[rate]:
                print(f"{row['part']:46}{row['p50_ms']:>8}{row['p99_ms']:>8}{row['verdicts']:>10}")
    if options.json:
        print(json.dumps(tables, indent=2))


def show_buses(options: argparse.Namespace) -> None:
    """Print the CPU of a frame with several buses, at the same rate of all frames together; three rounds in turn."""
    for rate in options.rates:
        found: dict[int, list[dict]] = {}
        for _ in range(3):
            for buses in options.buses:
                found.setdefault(buses, []).append(measure(our_side, None, False, rate, options.seconds, buses))
        for buses, runs in found.items():
            cpu = sorted(round(run["cpu_us"], 1) for run in runs)
            print(f"{rate:>7}/s, {buses} buses: {cpu} us of CPU a frame, lost {sum(run['lost_all'] for run in runs)}")


def least_side(opener: Any, config: Path, memory: Any, ready: Any, end: Any, out: Any) -> None:
    """Only answer each frame whose CRC is wrong, unpacked and unchecked: what sender, sockets and scheduler take."""
    sock, right = opener.args[0], frozenset(datagrams())
    sock.setblocking(True)
    sock.settimeout(0.1)
    ready.set()
    decoded = wrong = 0
    while not end.is_set():
        try:
            raw = sock.recv(72)
        except TimeoutError:
            continue
        if raw in right:
            decoded += 1
        else:
            wrong += 1
            sock.send(DTC_ID.to_bytes(4, "little") + bytes([8, 0, 0, 0, 0, raw[0] & 0x0F, 0, 0, 0, 0, 1, 1]))
    out.put({"decoded": decoded, "lost": 0, "cpu_us": time.process_time_ns() / 1e3 / max(decoded, 1)})


#: What receives, by its name of ``--only``: how tables have it, the process, whether its memory is on the disk.
SIDES = {
    "durable": ("gateway, memory durable", our_side, True),
    "process": ("gateway, memory in process", our_side, False),
    "computes": ("gateway, in process, beside a thread that computes", partial(our_side, beside=True), False),
    "realtime": (
        "gateway --realtime, likewise",
        partial(our_side, beside=True, realtime=True),
        False,
    ),
    "python-can": ("python-can Notifier + cantools", their_side, False),
    "least": ("a loop that only answers", least_side, False),
}


def latency_row(name: str, found: dict, seconds: float) -> dict:
    """Return a row of the table of latencies."""
    p50, p99, p999 = np.percentile(np.asarray(found["times"] or [np.nan]), [50, 99, 99.9])
    return {
        "name": name,
        "per_second": round(found["sent"] / seconds),
        "lost": found["lost_all"],
        "dtcs": len(found["times"]),
        "cpu_us": round(found["cpu_us"], 1),
        "p50_ms": round(float(p50), 3),
        "p99_ms": round(float(p99), 3),
        "p99.9_ms": round(float(p999), 3),
    }


def show_tables(options: argparse.Namespace) -> None:
    """Print latencies at each rate, then sustained rates, each as soon as it is known."""
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    progress = partial(print, file=sys.stderr if options.json else sys.stdout, flush=True)
    only = options.only or [*SIDES, "sustained"]
    sides, rows = [SIDES[name] for name in SIDES if name in only], []
    progress(f"{machine}; over {options.interface or 'a unix socket'}; sender on another core")
    if sides:
        progress(
            f"{'frame to DTC frame':64}{'lost':>8}{'DTCs':>6}{'p50':>9}{'p99':>9}{'p99.9':>9} ms{'CPU us/frame':>14}"
        )
    for rate in options.rates:
        for name, side, memory in sides:
            found = measure(side, options.interface, memory, rate, options.seconds, rest_s=options.rest)
            row = latency_row(f"{name}: {rate}/s", found, options.seconds)
            rows.append(row)
            progress(
                f"{row['name']:64}{row['lost']:>8,}{row['dtcs']:>6}{row['p50_ms']:>9}"
                f"{row['p99_ms']:>9}{row['p99.9_ms']:>9}{row['cpu_us']:>17}"
            )
    against = 0.0
    for key in ("python-can", "durable", "process") if "sustained" in only else ():
        name, side, memory = SIDES[key]
        rate = sustained(side, options.interface, memory, 1.0)
        against = against or max(rate, 1.0)
        row = {"name": f"{name}: sustained", "per_second": round(rate), "ratio": round(rate / against, 1)}
        rows.append(row | {"against": f"{SIDES['python-can'][0]}: sustained"})
        progress(f"{row['name']:48}{row['per_second']:>10,} frames/s{row['ratio']:>8.1f}x")
    if options.json:
        print(json.dumps({"rows": rows, "machine": machine}, indent=2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rates", type=int, nargs="+", default=[4000, 80_000])
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--only", nargs="+", choices=[*SIDES, "sustained"], help="only these rows")
    parser.add_argument("--rest", type=float, default=0.0, help="the sender's sleep between two looks [s], on one core")
    parser.add_argument("--interface", help="SocketCAN interface instead of a unix socket")
    parser.add_argument(
        "--buses", type=int, nargs="+", help="only the CPU of a frame, with so many buses in turn, no faults"
    )
    parser.add_argument("--parts", action="store_true", help="only the parts of a verdict, memory durable")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.parts:
        show_parts(options)
    elif options.buses:
        show_buses(options)
    else:
        show_tables(options)


if __name__ == "__main__":
    main()
