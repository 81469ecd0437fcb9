"""What four processes that report test results cost the frames: the time from a frame to its DTC frame.

The daemon of bench/live.py with a report socket, its memory durable. Pairs in turn: the same frames without reporters,
then with four processes that report at a rate; a part of the reports changes a DTC. In the last pair one process is
killed. What they were told is compared with what the gateway counted. First what a report costs the loop, as CPU time.

    python bench/report.py [--pairs 4] [--seconds 10] [--rate 2000] [--reports 10000] [--changes 0.1] [--json]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import random
import signal
import socket
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from live import BUFFER, StructBus, write_config
from live_sender import datagrams, send_at

from gateway.config.load import load_config
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.live.loop import Live
from gateway.report import Reporter
from gateway.runtime.app import Gateway
from gateway_serve.report_socket import ReportSocket

REPORTERS, FAULTS = 4, 4


def add_reporters(config: Path, place: Path) -> None:
    """Add the table of the reporters; their DTCs are none that bench/live.py waits for."""
    text = f'[report]\nsocket = "{place}"\n'
    for r in range(REPORTERS):
        text += f'[[report.reporter]]\nname = "r{r}"\nevents_per_s = 1000\n'
        for f in range(FAULTS):
            text += f'[[report.reporter.fault]]\nname = "f{f}"\ndtc = "B2{r}{0xF0 + f:02X}-00"\n'
            text += f'description = "fault {f}"\ndata = ["number"]\n'
    config.write_text(config.read_text() + text)


def daemon_side(sock: socket.socket, config: Path, memory: Path, ready: Any, end: Any, out: Any) -> None:
    """Run the gateway's live loop in this process."""
    gateway = Gateway(load_config(config), memory)
    gateway.write_beside()
    clock = Clock()
    link = Link("test:live", 0, "b", lambda uri, index: StructBus(sock, index), clock)
    link.start()
    gateway.start(time.time_ns())
    table = gateway.config.report
    door = None if table is None else ReportSocket(table, gateway)
    live = Live(gateway, [link], lambda event: None, clock=clock, door=door)
    for _ in range(20):
        live.turn()
    ready.set()
    live.run(end.is_set)
    for _ in range(200):
        live.turn()
    out.put({"states": gateway.reports.states(), "lost": link.statistics.overflow})
    link.close()
    gateway.close()


def reporter_side(name: str, place: Path, count: int, seconds: float, changes: float, seen: Any) -> None:
    """Report at a rate; ``seen``: shared, how many were begun, accepted, refused."""
    draw = random.Random(name)
    reporter = Reporter(place, patience_s=30.0)
    failing = [False] * FAULTS
    begun = time.perf_counter()
    for k in range(count):
        time.sleep(max(begun + k * seconds / count - time.perf_counter(), 0.0))
        f = draw.randrange(FAULTS)
        failing[f] ^= draw.random() < changes
        seen[0] = k + 1
        reporter.report(f"{name}.f{f}", "failed" if failing[f] else "passed", number=k)
        seen[1], seen[2] = reporter.accepted, sum(reporter.refused.values())
    reporter.goodbye()


def measure(options: argparse.Namespace, *, reporters: bool, kill: bool) -> dict:
    """Send frames for a while, and return the times to DTC frames, and what was counted."""
    context = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config, place = write_config(folder), folder / "report.sock"
        add_reporters(config, place)
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for each in (ours, theirs):
            each.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        ready, end, out = context.Event(), context.Event(), context.Queue()
        daemon = context.Process(target=daemon_side, args=(ours, config, folder / "f.sqlite", ready, end, out))
        daemon.start()
        if not ready.wait(300):
            raise SystemExit("the gateway did not start")
        seen = [context.Array("q", 3) for _ in range(REPORTERS)]
        each_count = options.reports // REPORTERS // options.pairs
        children = [
            context.Process(
                target=reporter_side, args=(f"r{r}", place, each_count, options.seconds, options.changes, seen[r])
            )
            for r in range(REPORTERS if reporters else 0)
        ]
        for child in children:
            child.start()
        halves = []
        for half in range(2):
            halves.append(send_at(theirs, options.rate, options.seconds / 2, datagrams()))
            if kill and not half:
                os.kill(children[0].pid, signal.SIGKILL)
        for child in children:
            child.join()
        end.set()
        found = out.get(timeout=60)
        daemon.join(20)
        theirs.close()
    times = [t for half in halves for t in half["times"]]
    return found | {"times": times, "full": sum(h["full"] for h in halves), "seen": [list(s) for s in seen]}


def cost_of_a_report(changes: float, count: int = 2000) -> dict[str, float]:
    """Return what reports take of the loop's thread, socket and answer included [us of CPU time]."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config, place = write_config(folder), folder / "report.sock"
        add_reporters(config, place)
        gateway = Gateway(load_config(config), folder / "f.sqlite")
        gateway.write_beside()
        gateway.start(0)
        gateway.advance(1)
        door = ReportSocket(gateway.config.report, gateway)
        draw, failing, times = random.Random(0), False, []
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as reporter:
            reporter.connect(str(place))
            door.turn(0.0)
            for k in range(count):
                failing ^= draw.random() < changes
                asked = {"fault": "r0.f0", "result": "failed" if failing else "passed", "data": {"number": k}, "id": k}
                reporter.send(json.dumps(asked).encode())
                begun = time.thread_time()
                door.turn(k / 100)
                times.append((time.thread_time() - begun) * 1e6)
                gateway.advance((k + 1) * 10_000_000)
                reporter.recv(4096)
        door.close()
        gateway.close()
    p50, p99 = np.percentile(times[100:], [50, 99])
    return {"p50_us": round(float(p50), 1), "p99_us": round(float(p99), 1)}


def check(found: dict, killed: int | None) -> list[str]:
    """Return what is not accounted for, one line each."""
    wrong = []
    for r, state in enumerate(found["states"][:REPORTERS]):
        begun, accepted, refused = found["seen"][r]
        counted = sum(n for outcome, n in state["counts"].items() if outcome != "lost")
        if r == killed:
            good = accepted + refused <= counted <= begun and state["counts"].get("lost") == 1 and state["lost"]
        else:
            good = (
                begun == accepted + refused == counted
                and accepted == state["counts"].get("accepted", 0)
                and not state["lost"]
            )
        if not good:
            wrong.append(f"r{r}: begun {begun}, accepted {accepted}, refused {refused}; the gateway: {state}")
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each half of a pair")
    parser.add_argument("--rate", type=int, default=2000, help="frames a second")
    parser.add_argument("--reports", type=int, default=10_000, help="of all pairs and reporters")
    parser.add_argument("--changes", type=float, default=0.1, help="part of the reports that change a DTC")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows, wrong, reports = [], [], 0
    cost = cost_of_a_report(options.changes)
    for pair in range(options.pairs):
        last = pair == options.pairs - 1
        for reporters in (False, True):
            found = measure(options, reporters=reporters, kill=last and reporters)
            if reporters:
                wrong += check(found, 0 if last else None)
                reports += sum(begun for begun, _, _ in found["seen"])
            p50, p99 = np.percentile(found["times"], [50, 99])
            row = {"pair": pair, "reporters": reporters, "verdicts": len(found["times"])}
            row |= {"lost": found["lost"] + found["full"]}
            rows.append(row | {"p50_ms": round(float(p50), 3), "p99_ms": round(float(p99), 3)})
    whole = {
        "rows": rows,
        "cost": cost,
        "reports": reports,
        "wrong": wrong,
        "machine": platform.processor() or platform.machine(),
    }
    if options.json:
        print(json.dumps(whole, indent=2))
    else:
        print(f"a report takes of the loop: p50 {cost['p50_us']} us, p99 {cost['p99_us']} us of CPU time")
        print(f"{'pair':>4} {'reporters':>9} {'verdicts':>8} {'lost':>5} {'p50 ms':>8} {'p99 ms':>8}")
        for row in rows:
            print(
                f"{row['pair']:>4} {'four' if row['reporters'] else 'none':>9} {row['verdicts']:>8} {row['lost']:>5}"
                f" {row['p50_ms']:>8.3f} {row['p99_ms']:>8.3f}"
            )
        for reporters in (False, True):
            mine = [row for row in rows if row["reporters"] == reporters]
            middle = [np.median([row[key] for row in mine]) for key in ("p50_ms", "p99_ms")]
            print(f"{'four' if reporters else 'none'}: median p50 {middle[0]:.3f} ms, p99 {middle[1]:.3f} ms")
        print(f"{reports} reports begun; " + ("; ".join(wrong) if wrong else "all accounted for"))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
