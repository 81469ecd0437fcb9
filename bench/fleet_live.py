"""A fleet of simulated cars on the road: 1000 cars over mosquitto, links down half the time, cars and collector killed.

A worker process plays many cars: each has a fault memory of its own and packs as ``gateway fleet join`` does. Time is
compressed: a turn is an hour of driving. ``python bench/fleet_live.py [--cars N] [--turns N]`` prints what was lost,
dropped and there twice; ``--campaign`` what becomes of a bad one;
``--rate`` how many events a second one collector keeps.
"""

import argparse
import itertools
import multiprocessing
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from gateway.faults.catalogue import Catalogue
from gateway.faults.fleet import FleetParams
from gateway.faults.memory import FaultMemory
from gateway.faults.records import Changes
from gateway.faults.resilient_store import ResilientStore
from gateway_fleet.live.batch import digest_of, packed, topic
from gateway_fleet.live.collect import Came, Collector
from gateway_fleet.live.deliver import digest_in
from gateway_fleet.live.statistics import _Test, columns
from gateway_serve.broker import Broker, BrokerLink

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))
from judging import Fleet

GATEWAY = (sys.executable, "-c", "from gateway.cli import main; main()")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def mosquitto(folder, port):
    folder.chmod(0o755)
    (folder / "mosquitto.conf").write_text(
        f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\nmax_queued_messages 100\nuser root\n"
    )
    return subprocess.Popen(
        [str(shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")), "-c", folder / "mosquitto.conf"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def event(n):
    return {
        "event": "dtc", "t_ns": n, "bus": "can0", "fault": "speed.V.high", "dtc": "P0501-84", "status": 47, "fdc": 127,
        "occurrence": n, "evidence": {"value": 12.5, "threshold": 12.0},
    }  # fmt: skip


def diagnosis(n, causes):
    return {"event": "diagnosis", "t_ns": n, "groups": [{"failed": ["speed.V.high"], "cause": [c]} for c in causes]}


def statistics(n, rng, centre, spread, hours=1.0):
    worst = centre + spread * (rng.standard_t(6, (60, 60)) * np.sqrt(4 / 6)).max(axis=1)
    tests = columns({"speed.V.high": (_Test(sign=1, limit=20.0), worst.tolist())})
    return {
        "event": "statistics", "t_ns": n, "begin_ns": n - 3600 * 10**9, "part": 0, "condition": "", "block_s": 60.0,
        "seconds": 3600.0 * hours, "tests": tests,
    }  # fmt: skip


class Car:
    """One car: its memory, opened for a turn only."""

    def __init__(self, folder, number, most):
        self.params = FleetParams(
            name="bench", car=f"car{number:05d}", model=f"m{number % 3}", software=f"s{number % 2}", bytes=most
        )
        self.path = folder / f"{number}.sqlite"
        self.random = random.Random(number)
        self.rng = np.random.default_rng(number)
        self.centre, self.spread = self.rng.normal(), np.exp(self.rng.normal(0, 0.2))
        self.written = 0
        self.store, self.memory = None, None
        self.sent, self.left = {}, True

    def open(self):
        if self.store is None:
            self.store = ResilientStore(self.path)
            self.memory = FaultMemory(Catalogue(()), self.store, fleet=self.params)

    def close(self):
        """Keep nothing that was not committed."""
        if self.store is not None:
            self.store.close()
            self.store = None

    def drive(self):
        """An hour: two events and statistics, ended before the commit once in ten; returns whether they are kept."""
        self.open()
        new = [event(self.written + 1), event(self.written + 2)]
        new.append(statistics(self.written + 3, self.rng, self.centre, self.spread))
        for each in new:
            self.memory.fleet.post(each, detail=each["event"] == "statistics")
        if self.random.random() < 0.1:
            self.close()
            return False
        assert self.memory.commit(final=True)
        self.written += 3
        return True


def work(place, numbers, port, turns, most):
    """Play cars; the link of each is down half the time. All that is known is on the disk, for it is killed."""
    log = place / f"driven-{numbers[0]}"
    turn, written = 0, {}
    for line in log.read_text().split("\n")[:-1] if log.exists() else ():
        name, count = line.split()
        turn, written[name] = (int(count), written.get(name)) if name == "turn" else (turn, int(count))
    cars = {f"car{number:05d}": Car(place, number, most) for number in numbers}
    for name, car in cars.items():
        car.written = written.get(name) or 0
    waiting, lock = {name: {} for name in cars}, threading.Lock()

    def take(name, payload):
        with lock:
            waiting.get(name.split("/")[3], {}).pop(digest_in(payload), None)

    link = BrokerLink(Broker(host="127.0.0.1", port=port), f"cars-{numbers[0]}", [topic("bench", "+", "arrived")], take)
    link.begin()
    stop = place / "stop"
    with log.open("a", buffering=1) as said:
        while not stop.exists() or any(car.left for car in cars.values()):
            over = stop.exists()
            for name, car in cars.items():
                if turn < turns and car.drive():
                    said.write(f"{name} {car.written}\n")  # after the commit: more may be on the disk, never less
                down = not over and car.random.random() < 0.5
                car.open()
                with lock:
                    here = waiting[name]
                    arrived = [rows for digest, (rows, _) in car.sent.items() if digest not in here]
                    young = {d: of for d, of in car.sent.items() if d in here and time.monotonic() < of[1] + 5.0}
                    car.sent = young
                    waiting[name] = dict.fromkeys(young, True)
                for gone in arrived:
                    car.store.save(Changes(arrived=gone, outgoing_bytes=most))
                rows = car.store.outgoing(0, 200)
                car.left = bool(rows)
                if rows and not down and not car.sent and link.is_there:
                    payload, going = packed(car.params, rows, car.store.tally())
                    digest = digest_of(payload)
                    with lock:
                        waiting[name][digest] = True
                    car.sent[digest] = going, time.monotonic()
                    link.publish(topic("bench", name, "events"), payload)
                car.close()
            turn += 1
            said.write(f"turn {turn}\n")
    link.end()


def known(place, shares):
    """Return turns of each worker, and the events of each car that are on its disk for sure."""
    turns, written = [], {}
    for share in shares:
        log = place / f"driven-{share[0]}"
        lines = log.read_text().split("\n")[:-1] if log.exists() else []
        turns.append(max((int(line.split()[1]) for line in lines if line.startswith("turn")), default=0))
        written |= {name: int(count) for name, count in map(str.split, lines) if name != "turn"}
    return turns, written


def live(args):
    place = Path(tempfile.mkdtemp(prefix="fleet-live-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    port, out = free_port(), place / "out"
    broker = mosquitto(place, port)
    words = [*GATEWAY, "fleet", "collect", out, "--fleet", "bench", "--broker", f"127.0.0.1:{port}", "--every", "10"]

    def collect():
        return subprocess.Popen([str(word) for word in words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def begun_worker(share):
        worker = multiprocessing.Process(target=work, args=(place, share, port, args.turns, args.bytes))
        worker.start()
        return worker

    collector = collect()
    shares = [list(range(k, args.cars, args.workers)) for k in range(args.workers)]
    workers = [begun_worker(share) for share in shares]
    begun, kills = time.monotonic(), dict.fromkeys(("worker", "collector", "broker"), 0)
    order, next_kill = itertools.cycle(kills), begun + args.every
    try:
        while min(known(place, shares)[0]) < args.turns:
            time.sleep(0.2)
            assert all(worker.is_alive() for worker in workers), "a worker has ended by itself"
            if time.monotonic() > next_kill:
                killed = next(order)
                kills[killed] += 1
                if killed == "worker":
                    k = kills[killed] % len(workers)
                    workers[k].kill()
                    workers[k].join()
                    workers[k] = begun_worker(shares[k])
                elif killed == "collector":
                    collector.kill()
                    collector.wait()
                    collector = collect()
                else:
                    broker.kill()
                    broker.wait()
                    time.sleep(1)
                    broker = mosquitto(place, port)
                next_kill = time.monotonic() + args.every
        (place / "stop").touch()
        for worker in workers:
            worker.join()
        collector.send_signal(signal.SIGTERM)
        collector.wait(120)
    finally:
        for each in (broker, collector, *workers):
            each.kill()
    return told_of(place, known(place, shares)[1], kills, time.monotonic() - begun, args)


def told_of(place, written, kills, seconds, args):
    """Print what was lost or is there twice; returns the exit code."""
    ids = {f"car{number:05d}": set() for number in range(args.cars)}
    there = 0
    for path in (place / "out" / "events").glob("*/[!.]*.parquet"):
        found = pq.ParquetFile(path).read(["car", "origin", "number"]).to_pylist()
        there += len(found)
        for row in found:
            ids[row["car"]].add((row["origin"], row["number"]))
    lost = dropped = last = 0
    for number, (name, kept) in enumerate(ids.items()):
        with closing(ResilientStore(place / f"{number}.sqlite")) as store:
            tally = store.tally()
        last, dropped = last + tally.last, dropped + tally.dropped
        sure = max(tally.last, written.get(name, 0))  # what a commit had said is on the disk has to be there
        lost += max(sure - len(kept) - tally.dropped, 0)
    unique = sum(map(len, ids.values()))
    told = ", ".join(f"{name} {count}" for name, count in kills.items())
    print(f"cars {args.cars}, turns {args.turns}, {seconds:.0f} s; killed (SIGKILL): {told}")
    print(f"events on the cars' disks {last}, of these told by a commit {sum(written.values())}")
    print(f"in the tables {unique}, dropped for room and counted {dropped}; lost {lost}, there twice {there - unique}")
    size = sum(path.stat().st_size for path in (place / "out" / "tests").glob("*/[!.]*.parquet"))
    print(f"bytes of a drive's row in the table tests: {size / max(there / 3, 1):.0f}")
    shutil.rmtree(place)
    return 0 if lost == 0 and there == unique else 1


def campaign(_args):
    """A bad campaign at 1 % of 1000 cars, 30 of which judge: limits that cold days exceed, which the shadow had not."""
    place = Path(tempfile.mkdtemp(prefix="fleet-campaign-"))
    fleet = Fleet(place)
    for name, limit in (("good", 15.5), ("bad", 13.5)):
        now = fleet.campaign(limit)
        inside = fleet.join(now, 30, 20)
        fleet.offer(now)
        for hour in range(1, 9):
            fleet.drive(13.0 if hour == 1 else 14.5)
            stage, why = fleet.next(now, 5.0 * len(inside))
            if stage is not None:
                break
        print(f"a {name} campaign at {len(inside)} of 1000 cars, after {hour} h of driving each: {why}")
        fleet.offer(stage)
        states = {car.trials.state.state for car in inside}
        print(f"  these cars then: {', '.join(states)}")
        if stage.withdrawn != (name == "bad") or states != {"back" if stage.withdrawn else "active"}:
            return 1
    shutil.rmtree(place)
    return 0


def rate(args):
    """Events a second that one collector keeps, of batches that lie ready."""
    place = Path(tempfile.mkdtemp(prefix="fleet-rate-"))
    memory = place / "a.sqlite"
    store = ResilientStore(memory)
    car = FleetParams(name="bench", car="car00000", model="m", software="s", bytes=10**9)
    kept = FaultMemory(Catalogue(()), store, fleet=car)
    for n in range(5):
        kept.fleet.post(event(n))
    kept.commit(final=True)
    rows, tally = store.outgoing(), store.tally()
    batches = []
    for k in range(args.cars * 5):
        one = car.model_copy(update={"car": f"car{k % args.cars:05d}"})
        new = [row._replace(id=f"{k:x}-{n}") for n, row in enumerate(rows, 1)]
        batches.append((one.car, packed(one, new, tally)[0]))
    store.close()
    collector = Collector(place / "out", "bench", 1e9)
    begun, used = time.perf_counter(), time.process_time()
    done = threading.Event()

    def feed():
        for name, payload in batches:
            collector.put(Came(name, payload, lambda _: None))
        done.set()

    threading.Thread(target=feed).start()
    collector.run(done.is_set)
    seconds = time.perf_counter() - begun
    count = len(batches) * 5
    cpu = 1e6 * (time.process_time() - used) / count
    print(f"{count} events in {len(batches)} batches, kept, answered and in the tables: {count / seconds:.0f} events/s")
    print(f"CPU {cpu:.0f} us an event")
    collector.close()
    shutil.rmtree(place)
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cars", type=int, default=1000)
    parser.add_argument("--turns", type=int, default=4)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--bytes", type=int, default=1_000_000)
    parser.add_argument("--every", type=float, default=8.0, help="seconds between two kills")
    for name in ("campaign", "rate"):
        parser.add_argument(f"--{name}", action="store_true")
    arguments = parser.parse_args()
    chosen = [of for name, of in (("campaign", campaign), ("rate", rate)) if getattr(arguments, name)]
    sys.exit(max(of(arguments) for of in (chosen or [live])))
