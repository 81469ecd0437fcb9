"""All sockets of a gateway attacked at once, and honest clients beside: is each of them answered, and in time?

A daemon with DoIP (TCP, TLS, UDP), status socket, report socket, UDS on a bus; its page with SOVD; MQTT by a broker
whose answers are bent. Seeded fuzzers of bytes, states and times attack all of them (bench/attackers.py). In the second
half DoIP wants TLS: the configuration is read again.

    python bench/attack.py [--seconds 600] [--seed 1] [--untimed] [--json]

It ends with 1 where a promise fails: a process ended, an honest request had no answer, the 99th percentile of an honest
request is above P2 (but for --untimed), memory grew, an exception reached the second wall.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime as dt
import json
import os
import random
import re
import signal
import socket
import ssl
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from honest import PATIENCE_S, Honest, browser, on_the_bus, reader, reporter, tester

HERE = Path(__file__).parent
GATEWAY = [sys.executable, "-c", "from gateway.cli import main; main()"]
P2_S = 0.050
#: Memory that a process may grow by from this time on [MB, s].
GROWTH_MB, SETTLED_S = 12.0, 60.0
#: Source addresses of the honest testers.
PLAIN, SECURE = 0x0E10, 0x0E11
DBC = 'VERSION ""\nNS_ :\nBS_:\nBU_: A B\nBO_ 256 One: 8 A\n SG_ Level : 0|16@1- (0.01,0) [-300|300] "V" B\n'
CONFIG = """
name = "attacked"
[[bus]]
name = "a"
uri = "{uri}"
database = ["one.dbc"]
health = {{ unknown = "tell" }}
[[monitor]]
name = "level"
type = "signal"
signal = [{{ signal = "One.Level", plausible = [0, 10], failed_ms = 100 }}]
[memory]
path = "faults.sqlite"
[output.uds]
security = [{{ level = 1, secret = "00112233445566778899aabbccddeeff", attempts = 2, delay_s = 1.0 }}]
further = [{{ request = 0x7E2, response = 0x7EA }}]
[output.doip]
port = {doip}
bind = ["127.0.0.1"]
connections = 32
[output.doip.tls]
certificate = "gateway.pem"
key = "gateway.key"
client_ca = "gateway.pem"
port = {tls}
required = {required}
[status]
socket = "{status}"
readers = 64
[report]
socket = "{report}"
connections = 64
[[report.reporter]]
name = "mine"
events_per_s = 5000.0
[[report.reporter.fault]]
name = "hot"
dtc = "P0A7E-00"
description = "too hot"
[[report.reporter.fault]]
name = "honest"
dtc = "P0A7F-00"
description = "never there"
"""


def free_port() -> int:
    """Return a port that is free now, by TCP and UDP."""
    while True:
        with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            tcp.bind(("127.0.0.1", 0))
            with contextlib.suppress(OSError):
                udp.bind(tcp.getsockname())
                return int(tcp.getsockname()[1])


def write_certificate(folder: Path) -> None:
    """Write a certificate of the gateway, which it has signed itself, and its key."""
    now, key = dt.datetime.now(dt.UTC), ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "gateway")])
    made = (
        x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
        .serial_number(x509.random_serial_number()).not_valid_before(now - dt.timedelta(1))
        .not_valid_after(now + dt.timedelta(1)).sign(key, hashes.SHA256())
    )  # fmt: skip
    (folder / "gateway.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
    kept = (serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    (folder / "gateway.key").write_bytes(key.private_bytes(*kept))
    (folder / "gateway.key").chmod(0o600)


@contextlib.contextmanager
def command(folder: Path, *arguments: str, ready: str) -> Iterator[subprocess.Popen[str]]:
    """Run a command of the gateway, from the line on that says that it is ready; its log goes to a file."""
    log = (folder / f"{arguments[0]}.log").open("w")
    program = [*GATEWAY, *arguments] if arguments[0] != "mosquitto" else list(arguments)
    with (folder / f"{arguments[0]}.out").open("w") as out:
        started = subprocess.Popen(program, cwd=folder, stdout=out, stderr=log, text=True)
    try:
        limit = time.monotonic() + 300
        while ready not in Path(log.name).read_text():
            if started.poll() is not None or time.monotonic() > limit:
                sys.exit(f"{arguments[0]} did not start:\n{Path(log.name).read_text()}")
            time.sleep(0.05)
        yield started
    finally:
        if started.poll() is None:
            started.terminate()
        started.wait(60)
        log.close()


def bending_proxy(broker: int, seed: int) -> int:
    """Serve a way to the broker on which its answers are bent, doubled or cut by chance; returns its port."""
    rng, listener = random.Random(f"{seed} mqtt"), socket.create_server(("127.0.0.1", 0))

    def pass_on(come: socket.socket, go: socket.socket, *, bend: bool) -> None:
        with contextlib.suppress(OSError):
            while data := come.recv(1 << 16):
                if bend and rng.random() < 0.02:
                    data = data[: rng.randrange(len(data))] + rng.randbytes(rng.randrange(40))
                go.sendall(data)
        for each in (come, go):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def work() -> None:
        while True:
            client, _ = listener.accept()
            with contextlib.suppress(OSError):
                server = socket.create_connection(("127.0.0.1", broker))
                threading.Thread(target=pass_on, args=(client, server), kwargs={"bend": False}, daemon=True).start()
                threading.Thread(target=pass_on, args=(server, client), kwargs={"bend": True}, daemon=True).start()

    threading.Thread(target=work, daemon=True).start()
    return int(listener.getsockname()[1])


def online(port: int, base: str, patience_s: float) -> bool:
    """Return whether the broker is told, in this time, that the gateway is there."""
    from paho.mqtt.client import Client  # noqa: PLC0415
    from paho.mqtt.enums import CallbackAPIVersion  # noqa: PLC0415

    heard, there = threading.Event(), Client(CallbackAPIVersion.VERSION2)
    there.on_message = lambda _client, _data, told: heard.set() if told.payload == b"online" else heard.clear()
    there.connect("127.0.0.1", port)
    there.subscribe(f"{base}/status")
    there.loop_start()
    found = heard.wait(patience_s)
    there.loop_stop()
    return found


def rss_mb(process: subprocess.Popen[str]) -> float:
    """Return the memory that a process has now."""
    text = Path(f"/proc/{process.pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+)", text)[1]) / 1024


def waited_s(process: subprocess.Popen[str]) -> float:
    """Return how long a process has waited for a processor so far: others may use the machine, too."""
    return int(Path(f"/proc/{process.pid}/schedstat").read_text().split()[1]) / 1e9


def share(times_s: list[float], part: float) -> float:
    """Return a percentile [ms]."""
    ordered = sorted(times_s)
    return 1e3 * ordered[min(int(part * len(ordered)), len(ordered) - 1)] if ordered else float("nan")


class Bench:
    """The processes, the attack and the account of one run."""

    def __init__(self, folder: Path, options: argparse.Namespace) -> None:
        self.folder, self.options = folder, options
        self.seen: dict[str, Any] = {}
        self.rss: dict[str, list[tuple[float, float]]] = {}
        self.broken: list[str] = []
        (folder / "one.dbc").write_text(DBC)
        (folder / "tokens").write_text("attackers-own-control-token\n")
        (folder / "tokens").chmod(0o600)
        write_certificate(folder)

    def run(self) -> dict[str, Any]:
        """Attack; returns the account."""
        folder = self.folder
        ports = {name: free_port() for name in ("hub", "doip", "tls", "page", "mqtt")}
        sockets = {"status": str(folder / "status.sock"), "report": str(folder / "report.sock")}
        self.places: dict[str, Any] = {
            **ports,
            **sockets,
            "token": "attackers-own-control-token",
            "uri": f"loopback:127.0.0.1:{ports['hub']}/can0",
        }
        self._write("false")
        (folder / "mosquitto.conf").write_text(f"listener {ports['mqtt']} 127.0.0.1\nallow_anonymous true\n")
        proxy, page = bending_proxy(ports["mqtt"], self.options.seed), str(ports["page"])
        with contextlib.ExitStack() as stack:
            start = stack.enter_context
            start(command(folder, "bus", f"127.0.0.1:{ports['hub']}", ready="serving"))
            start(command(folder, "mosquitto", "-c", "mosquitto.conf", ready="running"))
            self.processes = {"daemon": start(command(folder, "run", "attacked.toml", ready="monitoring"))}
            serve = ("serve", "attacked.toml", "--port", page, "--control-token-file", "tokens")
            self.processes["page"] = start(command(folder, *serve, ready="http"))
            self.processes["mqtt"] = start(
                command(folder, "mqtt", f"127.0.0.1:{proxy}", "-c", "attacked.toml", ready="telling")
            )
            acts = self._attack()
            self._check(online(ports["mqtt"], "gateway/attacked", 60.0), "MQTT: the state is not told any more")
            for name, process in self.processes.items():
                self._check(process.poll() is None, f"{name} ended with {process.poll()}")
        codes = {name: process.returncode for name, process in self.processes.items()}
        self._check(not any(codes.values()), f"exit codes {codes}")
        return self._account(acts)

    def _write(self, required: str) -> None:
        (self.folder / "attacked.toml").write_text(CONFIG.format(**self.places, required=required))

    def _check(self, good: bool, text: str) -> None:
        if not good:
            self.broken.append(text)

    def _clients(self) -> list[Honest]:
        places, context = self.places, ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        sovd = ["/sovd/v1/components", "/sovd/v1/components/gateway/faults"]
        return [
            Honest("DoIP", lambda: tester(places["doip"], PLAIN, None), 0.05, timed=True),
            Honest("DoIP by TLS", lambda: tester(places["tls"], SECURE, context), 0.05, timed=True),
            Honest("UDS on the bus", lambda: on_the_bus(places["uri"]), 0.05, timed=True),
            Honest("status socket", lambda: reader(places["status"], self.seen), 0.2),
            Honest("report socket", lambda: reporter(places["report"]), 0.2),
            Honest("page", lambda: browser(places["page"], ["/", "/metrics"]), 0.7),
            Honest("SOVD", lambda: browser(places["page"], sovd), 0.7),
        ]

    def _attack(self) -> dict[str, int]:
        options, clients = self.options, self._clients()
        for each in clients:
            each.start()
        limit = time.monotonic() + 60
        while any(not each.times_s for each in clients) and time.monotonic() < limit:
            time.sleep(0.1)
        (self.folder / "places.json").write_text(json.dumps(self.places))
        script = [sys.executable, str(HERE / "attackers.py"), str(self.folder / "places.json")]
        attackers = subprocess.Popen(
            [*script, str(options.seed), str(options.seconds)], stdout=subprocess.PIPE, text=True
        )
        begun, reloaded, load = time.monotonic(), False, []
        before_s = waited_s(self.processes["daemon"])
        while attackers.poll() is None:
            passed = time.monotonic() - begun
            if not reloaded and passed > options.seconds / 2:
                reloaded = True
                self._have_tls_required(clients)
            for name, process in self.processes.items():
                if process.poll() is None:
                    self.rss.setdefault(name, []).append((passed, rss_mb(process)))
            load.append(os.getloadavg()[0])
            time.sleep(min(1.0, options.seconds / 20))
        time.sleep(1.0)
        self.load = statistics.mean(load)
        alive = self.processes["daemon"].poll() is None
        alive = self.processes["daemon"].poll() is None
        self.waited_s = waited_s(self.processes["daemon"]) - before_s if alive else 0.0
        for each in clients:
            each.stop.set()
        for each in clients:
            each.join(PATIENCE_S + 1)
        self.clients = clients
        self._check(attackers.returncode == 0, "an attacker failed itself")
        return json.loads((attackers.stdout.read() if attackers.stdout else "") or "{}")

    def _have_tls_required(self, clients: list[Honest]) -> None:
        """Read a configuration that wants TLS: it ends the connections by DoIP, so that these clients come again."""
        by_doip = [each for each in clients if each.name.startswith("DoIP")]
        for each in by_doip:
            each.rests.set()
        time.sleep(0.2)
        self._write("true")
        self.processes["daemon"].send_signal(signal.SIGHUP)
        limit = time.monotonic() + 60
        while "new configuration" not in (self.folder / "run.log").read_text() and time.monotonic() < limit:
            time.sleep(0.1)
        self._check("new configuration" in (self.folder / "run.log").read_text(), "the reload was not done")
        time.sleep(0.2)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        made = Honest("DoIP by TLS, required", lambda: tester(self.places["tls"], SECURE, context), 0.05, timed=True)
        made.start()
        clients.append(made)

    def _account(self, acts: dict[str, int]) -> dict[str, Any]:
        walls = self.seen.get("exceptions", {"first": {}, "second": {}})
        rows = []
        for each in self.clients:
            p50, p99, worst = (share(each.times_s, part) for part in (0.5, 0.99, 1.0))
            rows.append({"client": each.name, "answered": len(each.times_s), "failed": each.failures[:20],
                         "p50_ms": round(p50, 2), "p99_ms": round(p99, 2), "worst_ms": round(worst, 1)})  # fmt: skip
            self._check(
                bool(each.times_s) and not each.failures, f"{each.name}: {len(each.failures)} without an answer"
            )
            late = each.timed and not self.options.untimed and p99 > 1e3 * P2_S
            self._check(not late, f"{each.name}: p99 {p99:.1f} ms is above P2")
        memory, settled_s = {}, min(SETTLED_S, self.options.seconds / 2)
        for name, looks in self.rss.items():
            first = next((mb for at, mb in looks if at >= settled_s), looks[0][1])
            last = statistics.median(mb for _, mb in looks[-5:])
            memory[name] = {"first_mb": round(first, 1), "last_mb": round(last, 1)}
            long = self.options.seconds >= 2 * SETTLED_S  # before, processes still load what they need
            self._check(not long or last - first <= GROWTH_MB, f"{name}: memory grew from {first:.0f} to {last:.0f} MB")
        self._check("counters" in self.seen, "the gateway's counters were not seen")
        self._check(not sum(walls["second"].values()), f"second wall: {walls['second']}")
        return {"seconds": self.options.seconds, "seed": self.options.seed, "load": round(self.load, 2), "acts": acts,
                "waited_s": round(self.waited_s, 1),
                "clients": rows, "memory": memory, "first_wall": walls["first"],
                "second_wall": sum(walls["second"].values()), "broken": self.broken}  # fmt: skip


def tell(found: dict[str, Any]) -> None:
    """Print an account for people."""
    print(f"{found['seconds']:g} s, seed {found['seed']}, load {found['load']} on {os.cpu_count()} processors")
    print(f"the daemon waited {found['waited_s']} s for a processor")
    print("acts of the attackers: " + ", ".join(f"{name} {count}" for name, count in found["acts"].items()))
    for row in found["clients"]:
        failed = f", FAILED {len(row['failed'])}: {row['failed'][:3]}" if row["failed"] else ""
        times = f"p50 {row['p50_ms']} ms, p99 {row['p99_ms']} ms, worst {row['worst_ms']} ms"
        print(f"  {row['client']:<22} {row['answered']:>6} answered, {times}{failed}")
    for name, each in found["memory"].items():
        print(f"  {name:<22} {each['first_mb']} MB, at the end {each['last_mb']} MB")
    print(f"exceptions at the first wall: {sum(found['first_wall'].values())} {found['first_wall'] or ''}")
    print(f"exceptions at the second wall: {found['second_wall']}")
    print("\n".join(f"BROKEN: {each}" for each in found["broken"]) or "all promises held")


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--untimed", action="store_true", help="do not judge times: on a machine that is busy")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--folder", type=Path, help="keep logs here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = options.folder or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        found = Bench(folder, options).run()
    if options.json:
        print(json.dumps(found))
    else:
        tell(found)
    sys.exit(1 if found["broken"] else 0)


if __name__ == "__main__":
    main()
