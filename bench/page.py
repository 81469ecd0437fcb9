"""What an open page costs the daemon: from the frame to the DTC frame without pages, and with five of them, in one run.

The gateway of bench/live.py, its memory durable, with a status socket; `gateway serve` beside it, as `gateway run
--serve` starts it, and five readers of its stream in a process of their own. These stand for browsers on other
machines, and run as SCHED_IDLE: they take nothing from who has work here. With ``--hostile`` a third side: besides, the
requests of tests/support/hostile.py one after the other, and 20 clients that begin one and say no more.

Rounds are short and go in turn, each side the first as often as the last, so that what else this machine does comes to
all of them; ratios are those of quantiles over all rounds, with the middle 90 % of 1000 draws of whole rounds behind
them. "CPU" is what the page's process used, in percent of one processor.

    python bench/page.py [--rates 4000 80000] [--seconds 10] [--rounds 3] [--pages 5] [--hostile] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
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
from page_address import address_of

from gateway.config.load import load_config
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.live.loop import Live
from gateway.runtime.app import Gateway
from gateway_serve.status_socket import StatusSocket

QUANTILES = ("p50_ms", "p99_ms", "p99.9_ms")


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
    gateway.listen(status.report)
    loop = Live(gateway, [link], status.report, clock=clock, door=status)
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
    seen = watched.get(timeout=120) if watcher is not None else {"read": 0, "refused": 0, "cpu_s": 0.0}
    counted = {"decoded": gateway.engine.counters()["decoded"], "lost": link.statistics.overflow}
    out.put({**counted, **seen})
    status.close()
    link.close()
    gateway.close()


def watch(path, pages, harm, opened, end, out):
    """Serve the page, and read its stream so many times until the end; attack it, too, where it is asked for."""
    command = [sys.executable, "-c", "from gateway.cli import main; main()", "serve", "--status", str(path)]
    command += ["--port", "0", "--parent", str(os.getpid())]
    page = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    url, _, token = address_of(page.stderr.readline()).partition("#control=")
    counts = [0] * pages
    refused = 0

    def read(k):
        with urllib.request.urlopen(f"{url}api/stream") as stream, contextlib.suppress(http.client.IncompleteRead):
            while not end.is_set():
                counts[k] += len(stream.read1(1 << 16))

    for k in range(pages):
        threading.Thread(target=read, args=(k,), daemon=True).start()
    while min(counts) == 0:
        time.sleep(0.05)
    begun_s = cpu_s(page.pid)
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
    found = {"read": sum(counts), "refused": refused, "cpu_s": cpu_s(page.pid) - begun_s}
    page.terminate()
    page.wait()
    out.put(found)


def cpu_s(pid):
    """Return the processor time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def without(*arguments):
    shown_side(*arguments, pages=0)


def quantiles(rounds):
    """Return p50, p99, p99.9 of all times of some rounds [ms]."""
    return np.percentile(np.concatenate([one["times"] for one in rounds]), [50, 99, 99.9])


def spread(alone, other):
    """Return the middle 90 % of the ratios of quantiles, over draws of whole rounds; shape (2, 3)."""
    rng = np.random.default_rng(1)
    draws = [rng.integers(0, len(alone), len(alone)) for _ in range(1000)]  # of pairs: one time of day
    ratios = [quantiles([other[k] for k in draw]) / quantiles([alone[k] for k in draw]) for draw in draws]
    return np.percentile(ratios, [5, 95], axis=0)


def compared(rate, found, seconds):
    """Return a row for each side, the first of which is what the others are compared with."""
    rows = []
    alone = next(iter(found.values()))
    for name, rounds in found.items():
        row = {"name": f"{rate}/s, {name}", "lost": sum(one["lost_all"] for one in rounds)}
        row["dtcs"] = sum(len(one["times"]) for one in rounds)
        row |= dict(zip(QUANTILES, quantiles(rounds).tolist(), strict=True))
        row["page_cpu"] = sum(one["cpu_s"] for one in rounds) / seconds
        row |= {key: sum(one[key] for one in rounds) for key in ("read", "refused")}
        if rounds is not alone:
            row["ratios"] = (quantiles(rounds) / quantiles(alone)).tolist()
            row["spread"] = spread(alone, rounds).T.tolist()
        rows.append(row)
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rates", type=int, nargs="+", default=[4000, 80_000])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--pages", type=int, default=5)
    parser.add_argument("--hostile", action="store_true")
    parser.add_argument("--in-process", action="store_true", help="no fault memory on the disk: its stalls are longest")
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
        found = {name: [] for name in sides}
        for k in range(options.rounds):
            turned = list(sides)[k % len(sides) :] + list(sides)[: k % len(sides)]
            for name in turned:
                found[name].append(live.measure(sides[name], None, not options.in_process, rate, options.seconds))
        rows += compared(rate, found, options.rounds * options.seconds)
    if options.json:
        print(json.dumps({"rows": rows}, indent=2))
        return
    print(f"{platform.machine()}, {os.cpu_count()} cores; {options.rounds} rounds of {options.seconds} s in turn")
    print(f"{'frame to DTC frame':34}{'lost':>8}{'DTCs':>7}{'p50':>9}{'p99':>9}{'p99.9':>9} ms{'CPU':>7}")
    for row in rows:
        times = "".join(f"{row[name]:9.2f}" for name in QUANTILES)
        more = f"  {row['refused']} refused" if row["refused"] else ""
        print(f"{row['name']:34}{row['lost']:>8}{row['dtcs']:>7}{times}   {row['page_cpu']:7.1%}{more}")
        if "ratios" in row:
            told = [f"{q:.2f} ({a:.2f} to {b:.2f})" for q, (a, b) in zip(row["ratios"], row["spread"], strict=True)]
            print(f"{'':34}against no page: p50 {told[0]}, p99 {told[1]}, p99.9 {told[2]}")


if __name__ == "__main__":
    main()
