"""Claims about the virtual car beside its truth, and alarms of the configuration on other healthy drives."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gateway.bus.frames import Frames
from gateway.bus.logs import open_writer
from gateway.config.load import load_config
from gateway.engine.events import QUALIFIED_FAILED, Events
from gateway.runtime.assemble import prepare
from gateway_fleet.learn.counters import WRAPS
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.learn import Asked, Result, learn, of_log, write
from gateway_fleet.learn.lines import CHECK
from gateway_fleet.learn.proof import restore
from gateway_fleet.study.learn.drive import Way, frames_of
from gateway_fleet.study.learn.network import Network, Sent

#: Frames, and different payloads, that show a counter and a checksum.
SHOWN = 64


@dataclass
class Claims:
    """Claims of one car.

    Attributes:
        true: protections that there are: counters, checksums, cycles.
        found: of these.
        wrong: claims that are not so, one line each.
        missed: protections that were not found.
        unshown: of messages that came too seldom, or hardly changed.
        seconds: that ``gateway_fleet/learn`` took.
        codes: healthy drives' codes, fault -> how often.
        hours: of these drives.
    """

    true: int = 0
    found: int = 0
    wrong: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    unshown: list[str] = field(default_factory=list)
    seconds: float = 0.0
    codes: Counter[str] = field(default_factory=Counter)
    hours: float = 0.0


def learned(folder: Path, net: Network, frames: Frames, *, database: bool = True) -> tuple[Path, Result]:
    """Learn of one drive, with the car's database or without any; returns the file."""
    base = folder / "car.dbc"
    base.write_text(net.dbc())
    log = folder / "drive.log"
    log.unlink(missing_ok=True)
    with open_writer(log) as writer:
        writer.write(frames)
    out = folder / "car.toml"
    files = (str(base),) if database else ()
    bus = BusAsked("can0", "virtual:can0", files, files=files)
    result = learn(Asked("car", (bus,), (log,), out), lambda *_: None)
    write(result.files(out))
    return out, result


def judged(
    folder: Path, net: Network, seed: int, seconds: float, way: Way, *, database: bool = True
) -> tuple[Path, Claims]:
    """Learn of a drive, and compare what was claimed with what is so; returns the file."""
    frames = frames_of(net, seed, seconds, way)
    before = time.perf_counter()
    out, result = learned(folder, net, frames, database=database)
    claims = Claims(seconds=time.perf_counter() - before)
    lines = {place[2]: line for place, line in result.learned.lines.items() if place[1] == CHECK}
    for m in net.messages if database else [nameless(m) for m in net.messages]:
        keys = dict(lines[m.name].keys) if m.name in lines else {}
        if "counter" in keys:
            signals = {signal.name: signal for signal in result.observation.seen[0, m.name].message.signals}
            keys["counter"] = {"modulus": 1 << signals[keys["counter"]["signal"]].length} | keys["counter"]
        mine = frames[frames["can_id"] == m.can_id]
        changes = 0.7 * len(np.unique(mine["data"][:, :8].copy().view(np.uint64))) >= SHOWN
        least = (2 if database else WRAPS + 1) * (m.counter[3] if m.counter else 0)
        # Where nothing else changes, a sum counts as its counter does: a database must say which is which.
        often = 0.7 * len(mine) >= max(SHOWN, least) and (database or changes or m.checksum is None)
        _compare(claims, m, keys, often, changes)
    return out, claims


def nameless(m: Sent) -> Sent:
    """Return a message as it is called where no database has it."""
    counter = m.counter and (f"BYTE{m.counter[1] // 8}_COUNTER", *m.counter[1:])
    checksum = m.checksum and (f"byte {m.checksum[1] // 8}", *m.checksum[1:])
    return replace(m, name=f"ID_{m.can_id:X}", counter=counter, checksum=checksum)


def _compare(claims: Claims, m: Sent, keys: dict[str, object], often: bool, changes: bool) -> None:
    """Count the facts, and the claims about them.

    A protection counts as missed only where the log shows it: a counter of a message that came often enough, a checksum
    of one that had different payloads enough.
    """
    counter = keys.get("counter")
    checksum = next((keys[name] for name in ("checksum", "crc", "e2e") if name in keys), None)
    facts = [
        ("cycle", m.period_s > 0.0, "timeout_ms" in keys, "timeout_ms" in keys, keys.get("timeout_ms")),
        ("counter", m.counter is not None, counter is not None, _right_counter(m, counter), counter),
        ("checksum", m.checksum is not None, checksum is not None, _right_checksum(m, checksum), checksum),
    ]
    for name, there, claimed, right, said in facts:
        if there and not claimed and not {"counter": often, "checksum": changes}.get(name, True):
            claims.unshown.append(f"{m.name}: {name}")
            continue
        claims.true += there
        claims.found += there and claimed and right
        if there and not claimed:
            claims.missed.append(f"{m.name}: {name}")
        if claimed and not (there and right):
            claims.wrong.append(f"{m.name}: {name} {said}")


def _right_counter(m: Sent, said: object) -> bool:
    if m.counter is None or not isinstance(said, dict):
        return False
    return (said["signal"], said["modulus"]) == (m.counter[0], m.counter[3])


def _right_checksum(m: Sent, said: object) -> bool:
    if m.checksum is None or not isinstance(said, dict):
        return False
    # Of an exclusive or each byte is that of the others.
    return said.get("signal", m.checksum[0]) == m.checksum[0] or (said.get("rule") == "xor" and m.checksum[2].xor)


def healthy(out: Path, net: Network, seed: int, seconds: float, way: Way) -> Counter[str]:
    """Return the codes that another healthy drive sets, fault -> how often."""
    return codes_of(out, [frames_of(net, seed, seconds, way)])


def codes_of(out: Path, drives: Iterable[Frames]) -> Counter[str]:
    """Return the codes that drives set, fault -> how often; and identifiers that are told as unknown."""
    config = load_config(out)
    engine, new = prepare(config, out).engine, prepare(config, out).engine
    codes: Counter[str] = Counter()

    def hear(events: Events) -> None:
        for event in events[events["kind"] == QUALIFIED_FAILED]:
            fault = engine.faults[int(event["fault"])].id
            codes[fault] += not of_log(fault, ["can0"])  # that the bus slept is so

    for frames in drives:
        restore(engine, new, config)
        for part in np.array_split(frames, max(len(frames) // 5000, 1)):
            engine.process(part, hear)
        for can_id in engine.tables.strangers["can_id"][engine.tables.strangers["count"] > 0]:
            codes[f"unknown 0x{can_id:X}"] += 1
        engine.tables.strangers[:] = 0
    return codes
