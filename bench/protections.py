"""Protected messages with limits on their signals: the gateway beside the loop one would write, on the same frames.

One bus, 300 messages protected by eight rules in turn, 1000 signals with a range each. The peer is plain Python:
python-can's messages, the checksum functions of opendbc, autosar-e2e and crccheck, counters, cantools' decode, and each
value compared with its range and debounced by time. Smaller configurations, with as many frames, show whether a frame
costs what it carries, or what is configured.

    python bench/protections.py [--frames 60000] [--peer-frames 6000] [--repeat 3] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cantools
import e2e
import numpy as np
from crccheck.crc import Crc16CcittFalse
from opendbc.car.honda.hondacan import honda_checksum
from opendbc.car.hyundai.hyundaicanfd import hkg_can_fd_checksum
from opendbc.car.toyota.toyotacan import toyota_checksum
from opendbc.car.volkswagen.mqbcan import VOLKSWAGEN_MQB_MEB_CONSTANTS, volkswagen_mqb_meb_checksum

from gateway.bus.frames import FD, empty, put, to_message
from gateway.config.load import load_config
from gateway.runtime.app import Gateway

SIZES = ((30, 100), (100, 300), (300, 1000))
#: Time from one frame of a message to its next, between the frames of two messages it is this over their number [ns].
PERIOD_NS = 20_000_000
#: Frames of each message until each test of the gateway has passed: 50 for a checksum, 1 s for a range.
ROUNDS = 60
#: Four signals of data in each message, of so many bits.
DATA, BITS = 4, 10
IDS = bytes(range(17, 33))


class Rule(NamedTuple):
    """A protection.

    Attributes:
        toml: keys of the check; ``{id}`` is the message's identifier.
        signals: of the protection, as a DBC has them.
        length: of the message [byte].
        data: first bit of its data.
        counter: signal, number of its values.
        protect: identifier, payload with its counter: puts the checksum in.
        fits: identifier, payload: whether the checksum is right.
    """

    toml: str
    signals: tuple[str, ...]
    length: int
    data: int
    counter: tuple[int, int, int]
    protect: Callable[[int, bytearray], None]
    fits: Callable[[int, bytes], bool]


def byte_rule(name: str, compute: Callable[..., int], at: int, shift: int = 0, mask: int = 0xFF) -> dict[str, Any]:
    """Return how one of opendbc's functions makes and tests a checksum in one byte."""

    def protect(can_id: int, data: bytearray) -> None:
        data[at] = data[at] & ~(mask << shift)
        data[at] |= (compute(can_id, None, data) & mask) << shift

    def fits(can_id: int, data: bytes) -> bool:
        cleared = bytearray(data)
        return compute(can_id, None, cleared) & mask == data[at] >> shift & mask

    return {"toml": f'checksum = "{name}", counter = {{ signal = "COUNTER" }}', "protect": protect, "fits": fits}


def protect_canfd(can_id: int, data: bytearray) -> None:
    data[0:2] = hkg_can_fd_checksum(can_id, None, data).to_bytes(2, "little")


def fits_canfd(can_id: int, data: bytes) -> bool:
    return hkg_can_fd_checksum(can_id, None, bytearray(data)) == int.from_bytes(data[:2], "little")


def protect_crc16(_: int, data: bytearray) -> None:
    data[0:2] = Crc16CcittFalse.calc(data[2:]).to_bytes(2, "little")


def fits_crc16(_: int, data: bytes) -> bool:
    return Crc16CcittFalse.calc(data[2:]) == int.from_bytes(data[:2], "little")


def nibble(at: int, values: int) -> tuple[int, int, int]:
    """Return where a counter lies: bit, bits, values."""
    return at, 4, values


CHECKSUM_8, COUNTER_4 = "CHECKSUM : 0|8@1+", "COUNTER : 8|4@1+"
CRC_16, COUNTER_8 = "CHECKSUM : 0|16@1+", "COUNTER : 16|8@1+"
RULES = {
    "toyota": Rule(
        signals=("COUNTER : 0|8@1+", "CHECKSUM : 56|8@1+"), length=8, data=8, counter=(0, 8, 256),
        **byte_rule("toyota", toyota_checksum, 7),
    ),
    "honda": Rule(
        signals=("COUNTER : 60|2@1+", "CHECKSUM : 56|4@1+"), length=8, data=8, counter=(60, 2, 4),
        **byte_rule("honda", honda_checksum, 7, mask=0xF),
    ),
    "hyundai": Rule(
        'checksum = "hyundai_canfd", counter = { signal = "COUNTER" }', (CRC_16, COUNTER_8), 32, 24, (16, 8, 256),
        protect_canfd, fits_canfd,
    ),
    "volkswagen": Rule(
        signals=(CHECKSUM_8, COUNTER_4), length=8, data=16, counter=nibble(8, 16),
        **byte_rule("volkswagen_mqb", volkswagen_mqb_meb_checksum, 0),
    ),
    "E2E P01": Rule(
        'e2e = { profile = "P01", data_id = {id} }', (CHECKSUM_8, COUNTER_4), 8, 16, nibble(8, 15),
        lambda can_id, data: e2e.p01.e2e_p01_protect(data, can_id, increment_counter=False),
        lambda can_id, data: e2e.p01.e2e_p01_check(bytearray(data), can_id),
    ),
    "E2E P02": Rule(
        f'e2e = {{ profile = "P02", data_ids = {list(IDS)} }}', (CHECKSUM_8, COUNTER_4), 8, 16, nibble(8, 16),
        lambda _, data: e2e.p02.e2e_p02_protect(data, IDS, increment_counter=False),
        lambda _, data: e2e.p02.e2e_p02_check(data, IDS),
    ),
    "E2E P05": Rule(
        'e2e = { profile = "P05", data_id = {id} }', (CRC_16, COUNTER_8), 8, 24, (16, 8, 256),
        lambda can_id, data: e2e.p05.e2e_p05_protect(data, can_id, increment_counter=False),
        lambda can_id, data: e2e.p05.e2e_p05_check(data, can_id),
    ),
    "crc16": Rule(
        'crc = { signal = "CHECKSUM", algorithm = "crc16_ccitt_false", over = [2, 8] }, '
        'counter = { signal = "COUNTER" }',
        (CRC_16, COUNTER_8), 8, 24, (16, 8, 256), protect_crc16, fits_crc16,
    ),
}  # fmt: skip


class Car(NamedTuple):
    """Messages, each with its rule, and the limits of their signals.

    Attributes:
        ids: of the messages.
        rules: of the messages.
        limits: of each message: name of a signal, its range.
    """

    ids: list[int]
    rules: list[Rule]
    limits: list[list[tuple[str, float, float]]]


def make_car(messages: int, limits: int) -> Car:
    """Return so many messages, rule by rule in turn, with so many signals that have a range."""
    listed = sorted(VOLKSWAGEN_MQB_MEB_CONSTANTS)
    free = iter(can_id for can_id in range(1, 0x800) if can_id not in listed)
    known = iter(can_id for can_id in listed if can_id < 0x800)
    names = list(RULES)
    ids = [next(known, None) or next(free) if names[k % 8] == "volkswagen" else next(free) for k in range(messages)]
    ranges: list[list[tuple[str, float, float]]] = [[] for _ in ids]
    for k in range(limits):
        ranges[k % messages].append((f"S{k // messages}", 0.0, 100.0))
    return Car(ids, [RULES[names[k % 8]] for k in range(messages)], ranges)


def write(car: Car, folder: Path) -> Path:
    """Write database and configuration; returns the path of the latter."""
    dbc = ['VERSION ""\nNS_ :\nBS_:\nBU_: ECU GW']
    checks, signals = [], []
    for k, (can_id, rule) in enumerate(zip(car.ids, car.rules, strict=True)):
        dbc.append(f"BO_ {can_id} M{k}: {rule.length} ECU")
        dbc += [f' SG_ {signal} (1,0) [0|0] "" GW' for signal in rule.signals]
        dbc += [f' SG_ S{j} : {rule.data + BITS * j}|{BITS}@1+ (0.1,0) [0|0] "" GW' for j in range(DATA)]
        toml = rule.toml.replace("{id}", str(can_id))
        checks.append(f'{{ message = "M{k}", timeout_ms = 100, {toml} }}')
        signals += [
            f'{{ signal = "M{k}.{name}", name = "M{k}-{name}", plausible = [{low}, {high}] }}'
            for name, low, high in car.limits[k]
        ]
    (folder / "car.dbc").write_text("\n".join(dbc) + "\n")
    path = folder / "gateway.toml"
    separator = ",\n    "
    path.write_text(
        '[[bus]]\nname = "b"\nuri = "virtual:b"\ndatabase = ["car.dbc"]\ncodes = "own"\n'
        f"check = [\n    {separator.join(checks)},\n]\n"
        f'[[monitor]]\nname = "s"\ntype = "signal"\nsignal = [\n    {separator.join(signals)},\n]\n'
    )
    return path


def make_log(car: Car, count: int) -> Any:
    """Return so many healthy frames, message by message in turn: each signal wanders between 20 and 80."""
    rng = np.random.default_rng(1)
    n = len(car.ids)
    turns = -(-count // n)
    values = 50 + 30 * np.sin(np.cumsum(rng.uniform(0, 0.2, (turns, n, DATA)), axis=0))
    raw = np.round(values * 10).astype(int)
    frames = empty(turns * n)
    for turn in range(turns):
        for k, (can_id, rule) in enumerate(zip(car.ids, car.rules, strict=True)):
            at, _, modulus = rule.counter
            whole = turn % modulus << at
            for j in range(DATA):
                whole |= int(raw[turn, k, j]) << rule.data + BITS * j
            data = bytearray(whole.to_bytes(rule.length, "little"))
            rule.protect(can_id, data)
            t_ns = PERIOD_NS * turn + PERIOD_NS * k // n
            put(frames, turn * n + k, t_ns, can_id, bytes(data), flags=FD if rule.length > 8 else 0)
    return frames[:count]


class User:
    """What one writes with the libraries.

    Args:
        car: the messages.
        file: their database.
    """

    def __init__(self, car: Car, file: Path) -> None:
        database = cantools.database.load_file(file)
        self.messages = {
            can_id: (database.get_message_by_frame_id(can_id), rule, limits)
            for can_id, rule, limits in zip(car.ids, car.rules, car.limits, strict=True)
        }
        self.counters: dict[int, int] = {}
        self.came: dict[int, float] = {}
        self.since: dict[tuple[int, str], float] = {}
        self.looked = 0.0
        self.faults = 0
        self.values = 0

    def take(self, m: Any) -> None:
        """Take one python-can message."""
        can_id, data, now = m.arbitration_id, bytes(m.data), m.timestamp
        message, rule, limits = self.messages[can_id]
        self.came[can_id] = now
        if now - self.looked > 0.01:
            self.looked = now
            self.faults += sum(now - came > 0.1 for came in self.came.values())
        if not rule.fits(can_id, data):
            self.faults += 1
            return
        at, bits, modulus = rule.counter
        counter = int.from_bytes(data, "little") >> at & (1 << bits) - 1
        before = self.counters.get(can_id)
        self.counters[can_id] = counter
        if before is not None and (counter - before) % modulus != 1:
            self.faults += 1
            return
        values = message.decode(data, decode_choices=False)
        for name, low, high in limits:
            self.values += 1
            if low <= values[name] <= high:
                self.since.pop((can_id, name), None)
            elif now - self.since.setdefault((can_id, name), now) >= 0.5:
                self.faults += 1


def user_path(car: Car, file: Path, frames: Any) -> float:
    """Return how long the libraries take [s]; the frames are python-can's messages already."""
    user = User(car, file)
    messages = [to_message(frame) for frame in frames]
    begun = time.perf_counter()
    for message in messages:
        user.take(message)
    seconds = time.perf_counter() - begun
    assert user.faults == 0
    return seconds


def gateway_path(path: Path, frames: Any, first: int, chunk: int = 100_000) -> tuple[float, float, float]:
    """Return how long the whole gateway takes for the first frames and for the others, and to be built [s].

    With the first ones each of its tests passes for the first time, which is an event each.
    """
    begun = time.perf_counter()
    gateway = Gateway(load_config(path), file=path)
    built = time.perf_counter() - begun
    failed: list[Any] = []
    gateway.listen(lambda event: failed.append(event) if event["event"] == "dtc" else None)
    gateway.start(int(frames["t_ns"][0]))
    gateway.feed(frames[:1])
    begun = time.perf_counter()
    gateway.feed(frames[1:first])
    starting = time.perf_counter() - begun
    begun = time.perf_counter()
    for k in range(first, len(frames), chunk):
        gateway.feed(frames[k : k + chunk])
    seconds = time.perf_counter() - begun
    counters = gateway.engine.counters()
    assert counters["decoded"] == len(frames), counters
    assert not [event for event in failed if event["status"] & 1], failed[0]
    gateway.close()
    return starting, seconds, built


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=60_000)
    parser.add_argument("--peer-frames", type=int, default=6_000)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as named:
        cases = []
        for messages, limits in SIZES:
            folder = Path(named) / str(messages)
            folder.mkdir()
            car = make_car(messages, limits)
            first = ROUNDS * messages
            cases.append((messages, limits, car, write(car, folder), make_log(car, first + options.frames), first))
        best: dict[tuple[int, str], float] = {}
        # In turn, so that a machine that slows down slows all of them.
        for _ in range(options.repeat):
            for messages, _, car, path, frames, first in cases:
                starting, seconds, built = gateway_path(path, frames, first)
                peer = frames[: options.peer_frames]
                measured = {
                    "gateway": seconds / (len(frames) - first),
                    "starting": starting / first,
                    "peer": user_path(car, path.parent / "car.dbc", peer) / len(peer),
                    "built": built,
                }
                for name, value in measured.items():
                    best[messages, name] = min(best.get((messages, name), np.inf), value)
        for messages, limits, *_ in cases:
            ours, theirs = best[messages, "gateway"], best[messages, "peer"]
            rows.append(
                {
                    "messages": messages,
                    "limits": limits,
                    "gateway_us": 1e6 * ours,
                    "peer_us": 1e6 * theirs,
                    "ratio": theirs / ours,
                    "against": "python-can + cantools + opendbc, autosar-e2e, crccheck",
                    "starting_us": 1e6 * best[messages, "starting"],
                    "built_s": best[messages, "built"],
                }
            )
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    if options.json:
        print(json.dumps({"rows": rows, "machine": machine}, indent=2))
        return
    print(f"{machine}; {options.frames} frames, {options.peer_frames} of them for the peer; best of {options.repeat}")
    print("peer: python-can + cantools + checksums of opendbc, autosar-e2e, crccheck")
    print(
        f"{'messages':>9}{'limits':>8}{'gateway us/frame':>18}{'peer us/frame':>15}{'ratio':>8}"
        f"{'starting':>10}{'built in s':>12}"
    )
    for row in rows:
        print(
            f"{row['messages']:>9}{row['limits']:>8}{row['gateway_us']:>18.3f}{row['peer_us']:>15.1f}"
            f"{row['ratio']:>7.1f}x{row['starting_us']:>10.2f}{row['built_s']:>12.2f}"
        )


if __name__ == "__main__":
    main()
