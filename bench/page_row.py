"""How soon a trouble code is on the page: from its DTC frame on the bus to its row in a real browser.

Processes as a user starts them: ``gateway bus``, ``gateway run`` with the 16 protected messages of bench/live.py,
``gateway serve``, Debian's Chromium without a screen. A python-can client sends 800 frames/s, now and then one with a
wrong CRC, and notes when the DTC frame comes; a MutationObserver in the page notes when the row is there, and the next
animation frame when it is about to be painted. All by the clock of this machine.

    python bench/page_row.py [--rows 48] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import random
import re
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

import can
import live
import live_sender
import numpy as np
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))
from page_address import address_of

#: How long a row is waited for [s].
PATIENCE_S = 10.0

WATCH = """
window.rows = {};
const now = () => performance.timeOrigin + performance.now();
new MutationObserver(() => {
  for (const element of document.querySelectorAll("[data-dtc]")) {
    const dtc = element.dataset.dtc;
    if (window.rows[dtc]) continue;
    const row = (window.rows[dtc] = { there: now() });
    requestAnimationFrame(() => { row.painted = now(); });
  }
}).observe(document.getElementById("dtcs"), { childList: true, subtree: true });
"""


def started(folder: Path, ready: str, *arguments: object) -> tuple[subprocess.Popen, str]:
    """Start a command of the gateway; returns it and the line that says it is ready."""
    command = [sys.executable, "-c", "from gateway.cli import main; main()", *map(str, arguments)]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    for line in process.stderr:
        if ready in line:
            threading.Thread(target=process.stderr.read, daemon=True).start()
            return process, line
    raise SystemExit(f"{arguments[0]} ended with {process.wait()}")


def chromium(folder: Path) -> webdriver.Chrome:
    """Return a browser without a screen."""
    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for argument in ("headless=new", "disable-gpu", "no-first-run", f"user-data-dir={folder / 'profile'}"):
        options.add_argument(f"--{argument}")
    if os.geteuid() == 0:
        options.add_argument("--no-sandbox")
    return webdriver.Chrome(options=options, service=Service("/usr/bin/chromedriver"))


class Client:
    """Sends the messages of bench/live.py in turn, and notes when DTC frames of changes come."""

    def __init__(self, port: int) -> None:
        self.frames = live_sender.datagrams()
        self.bus = can.Bus(interface="socketcand", host="127.0.0.1", port=port, channel="can0")
        self.spoil: int | None = None
        self.seen: dict[int, float] = {}  # message -> time of its DTC frame [ms]
        self.ended = False
        self.threads = [threading.Thread(target=work, daemon=True) for work in (self.send, self.hear)]
        for thread in self.threads:
            thread.start()

    def send(self) -> None:
        sent = 0
        while not self.ended:
            for _ in range(live_sender.MESSAGES):
                frame = self.frames[sent % len(self.frames)]
                if self.spoil == frame[0] & 0x0F:
                    self.spoil, frame = None, live_sender.spoilt(frame)
                can_id = int.from_bytes(frame[:2], "little")
                self.bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=frame[8:]))
                sent += 1
            time.sleep(0.02)

    def hear(self) -> None:
        while not self.ended:
            message = self.bus.recv(0.2)
            now = time.time() * 1e3
            # A change (index 0) of one DTC; one that healed before it was written is told once, as healed.
            if (
                message is not None
                and message.arbitration_id == live_sender.DTC_ID
                and message.data[5] == 0 < message.data[0]
            ):
                self.seen.setdefault(message.data[1], now)

    def close(self) -> None:
        self.ended = True
        for thread in self.threads:
            thread.join()
        self.bus.shutdown()


def waited(what: object) -> object:
    """Wait until something is there; None: it did not come."""
    limit = time.monotonic() + PATIENCE_S
    while not (found := what()) and time.monotonic() < limit:
        time.sleep(0.02)
    return found


def measured(url: str, driver: webdriver.Chrome, client: Client, rows: int) -> list[dict[str, float]]:
    """Return of so many rows how long after the DTC frame they were there, and painted [ms]."""
    address, _, token = url.partition("#control=")
    driver.get(url)
    waited(lambda: driver.execute_script("return document.getElementById('link').textContent === 'monitoring'"))
    driver.execute_script(WATCH)
    draw = random.Random(1)
    found: list[dict[str, float]] = []
    while len(found) < rows:
        headers = {"content-type": "application/json", "authorization": f"Bearer {token}"}
        urllib.request.urlopen(urllib.request.Request(f"{address}api/clear", b"{}", headers)).read()
        waited(lambda: not driver.execute_script("return document.querySelectorAll('[data-dtc]').length"))
        client.seen.clear()
        driver.execute_script("window.rows = {}")
        for k in draw.sample(range(live_sender.MESSAGES), min(live_sender.MESSAGES, rows - len(found))):
            client.spoil = k
            dtc = f"U12{k:02X}-00"
            frame = waited(lambda k=k: client.seen.get(k))
            row = waited(lambda dtc=dtc: driver.execute_script("return window.rows[arguments[0]]?.painted", dtc))
            if frame is None or row is None:
                raise SystemExit(f"{dtc}: DTC frame {frame}, row {row}")
            told = driver.execute_script("return window.rows[arguments[0]]", dtc)
            found.append({"there": told["there"] - frame, "painted": told["painted"] - frame})
            time.sleep(draw.uniform(0.3, 1.0))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=48)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    running = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = live.write_config(folder)
        driver = client = None
        try:
            bus, said = started(folder, "serving", "bus", "127.0.0.1:0")
            running.append(bus)
            uri = re.search(r"loopback:\S+?:(\d+)", said)
            status = folder / "status"
            more = ("--bus", uri[0], "--status", status, "--memory", folder / "f.sqlite")
            running.append(started(folder, "monitoring", "run", config, *more)[0])
            page, said = started(folder, "page:", "serve", "--status", status, "--port", "0")
            running.append(page)
            client = Client(int(uri[1]))
            driver = chromium(folder)
            found = measured(address_of(said), driver, client, options.rows)
        finally:
            if client is not None:
                client.close()
            if driver is not None:
                driver.quit()
            for process in reversed(running):
                process.terminate()
                process.wait(60)
    rows = []
    for kind, text in (("there", "DTC frame to row in the page"), ("painted", "DTC frame to row painted")):
        times = np.asarray([each[kind] for each in found])
        quantiles = [float(q) for q in np.percentile(times, [50, 90, 100])]
        rows.append(
            {"name": text, "rows": len(times), **dict(zip(("p50_ms", "p90_ms", "max_ms"), quantiles, strict=True))}
        )
    machine = f"{platform.machine()}, {os.cpu_count()} cores"
    if options.json:
        print(json.dumps({"rows": rows, "machine": machine}, indent=2))
        return
    print(f"{machine}; {rows[0]['rows']} rows")
    for row in rows:
        print(f"{row['name']:32} p50 {row['p50_ms']:7.1f}  p90 {row['p90_ms']:7.1f}  max {row['max_ms']:7.1f} ms")


if __name__ == "__main__":
    main()
