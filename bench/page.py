"""What an open page costs the daemon: from the frame to the DTC frame without pages, and with five of them, in one run.

The gateway of bench/live.py, its memory durable, with a status socket; `gateway serve` beside it, and five readers of
its stream in a process of their own (a browser draws besides, on whatever machine it is). Rounds in turn. With
``--hostile`` a third side: besides, the requests of tests/support/hostile.py one after the other, and 20 clients that
begin one and say no more.

    python bench/page.py [--rates 4000 80000] [--seconds 10] [--rounds 3] [--pages 5] [--hostile] [--json]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import random
import re
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path

import live
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))
import hostile

from gateway.config.load import load_config
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.live.loop import Live
from gateway.live.status import StatusSocket
from gateway.runtime.app import Gateway


def shown_side(opener, config, memory, ready, end, out, *, pages, harm=False):
    """Run the gateway's live loop with a status socket, and so many pages beside it."""
    gateway = Gateway(load_config(config), memory)
    gateway.write_beside()
    clock = Clock()
    link = Link("test:live", 0, "b", opener, clock)
    link.start()
    gateway.start(time.time_ns())
    path = Path(config).parent / "status"
    status = StatusSocket(path, gateway)
    gateway.listen(status.tell)
    loop = Live(gateway, [link], status.tell, clock=clock, door=status)
    context = multiprocessing.get_context("fork")
    opened, watched = context.Event(), context.Queue()
    watcher = context.Process(target=watch, args=(path, pages, harm, opened, end, watched)) if pages else None
    if watcher is not None:
        watcher.start()
    limit = time.monotonic() + 60
    while (watcher is not None and not opened.is_set() and time.monotonic() < limit) or time.monotonic() < limit - 59:
        loop.turn()
    ready.set()
    loop.run(end.is_set)
    for _ in range(200):
        loop.turn()
    read, refused = watched.get(timeout=120) if watcher is not None else (0, 0)
    counted = {"decoded": gateway.engine.counters()["decoded"], "lost": link.statistics.overflow}
    out.put({**counted, "read": read, "refused": refused})
    status.close()
    link.close()
    gateway.close()


def watch(path, pages, harm, opened, end, out):
    """Serve the page, and read its stream so many times until the end; attack it, too, where it is asked for."""
    command = [sys.executable, "-c", "from gateway.cli import main; main()", "serve", "--status", str(path)]
    command += ["--port", "0", "--parent", str(os.getpid())]
    page = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    url, token = re.search(r"(http://\S+?/)#control=(\S+)", page.stderr.readline()).groups()
    counts = [0] * pages
    refused = 0

    def read(k):
        with urllib.request.urlopen(f"{url}api/stream") as stream:
            while not end.is_set():
                counts[k] += len(stream.read1(1 << 16))

    for k in range(pages):
        threading.Thread(target=read, args=(k,), daemon=True).start()
    while min(counts) == 0:
        time.sleep(0.05)
    opened.set()
    if harm:
        port = int(re.search(r":(\d+)/", url)[1])
        with hostile.slow_clients(port, 20):
            for attack in hostile.attacks(port, random.Random(1), control=token):
                if end.is_set():
                    break
                if hostile.said(port, attack.data)[0] not in attack.refusals:
                    raise SystemExit(f"{attack.kind} was not refused")
                refused += 1
    end.wait()
    page.terminate()
    page.wait()
    out.put((sum(counts), refused))


def without(*arguments):
    shown_side(*arguments, pages=0)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rates", type=int, nargs="+", default=[4000, 80_000])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--pages", type=int, default=5)
    parser.add_argument("--hostile", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    def shown(*arguments):
        shown_side(*arguments, pages=options.pages)

    def attacked(*arguments):
        shown_side(*arguments, pages=options.pages, harm=True)

    rows = []
    for rate in options.rates:
        sides = {"no page": without, f"{options.pages} pages": shown}
        if options.hostile:
            sides["hostile requests, too"] = attacked
        found = {name: {"times": [], "lost": 0, "read": 0, "refused": 0} for name in sides}
        for k in range(options.rounds):
            for name in list(sides)[:: 1 if k % 2 else -1]:
                one = live.measure(sides[name], None, True, rate, options.seconds)
                found[name]["times"] += one["times"]
                found[name]["lost"] += one["lost_all"]
                found[name]["read"] += one["read"]
                found[name]["refused"] += one["refused"]
        for name, all_of in found.items():
            quantiles = [float(q) for q in np.percentile(all_of["times"], [50, 99, 99.9])]
            row = {"name": f"{rate}/s, {name}", "lost": all_of["lost"], "dtcs": len(all_of["times"])}
            row |= dict(zip(("p50_ms", "p99_ms", "p99.9_ms"), quantiles, strict=True))
            row |= {"read_mb": all_of["read"] / 1e6, "refused": all_of["refused"]}
            rows.append(row)
        alone, *others = rows[-len(sides) :]
        for row in others:
            row |= {f"{name} ratio": row[name] / alone[name] for name in ("p50_ms", "p99_ms", "p99.9_ms")}
    if options.json:
        print(json.dumps({"rows": rows}, indent=2))
        return
    print(f"{platform.machine()}, {os.cpu_count()} cores; {options.rounds} rounds of {options.seconds} s in turn")
    print(f"{'frame to DTC frame':30}{'lost':>8}{'DTCs':>7}{'p50':>9}{'p99':>9}{'p99.9':>9} ms  ratios to no page")
    for row in rows:
        ratios = [f"{row[f'{n} ratio']:.2f}" for n in ("p50_ms", "p99_ms", "p99.9_ms") if f"{n} ratio" in row]
        times = "".join(f"{row[name]:9.2f}" for name in ("p50_ms", "p99_ms", "p99.9_ms"))
        more = f"  {row['refused']} refused" if row["refused"] else ""
        print(f"{row['name']:30}{row['lost']:>8}{row['dtcs']:>7}{times}     {'  '.join(ratios)}{more}")


if __name__ == "__main__":
    main()
