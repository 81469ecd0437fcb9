"""What the configuration sees: faults put into frames that it did not learn from, one at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gateway.bus.frames import Frames
from gateway.engine.core import Engine
from gateway.engine.events import QUALIFIED_FAILED, Events
from gateway.learn.document import SIGNAL_NAME, BusAsked, monitor_name
from gateway.learn.limits import representable
from gateway.learn.lines import CHECK, RULE, SIGNAL, Learned, Line
from gateway.learn.proof import Replayed, restore
from gateway.monitors.signal.parts import no_value
from gateway.runtime.injection import Injection, Injector
from gateway.signals.database import Database

#: A fault begins so long after the cut [s]; trials at most.
LEAD_S, MOST = 1.0, 400


@dataclass(frozen=True)
class Trial:
    """A fault, what must name it, and the message that it is put into, with its bus."""

    injection: Injection
    expected: str
    message: str


@dataclass(frozen=True)
class Outcome:
    """What came of a trial.

    Attributes:
        trial: it.
        frames: that the fault was in.
        named: whether the expected fault was set.
        others: further faults that were set.
    """

    trial: Trial
    frames: int
    named: bool
    others: tuple[str, ...]


def trials(
    learned: Learned,
    databases: Sequence[Database],
    buses: Sequence[BusAsked],
    seconds: float,
    periods_s: Mapping[tuple[int, str], float],
) -> Iterator[Trial]:
    """Yield the faults that a limit of the configuration can show.

    Args:
        learned: the lines.
        databases: of the buses.
        buses: as asked for.
        seconds: length of what was held out: a silence that takes longer cannot be shown in it.
        periods_s: (bus index, message) -> time between its frames [s].
    """
    index = {bus.name: k for k, bus in enumerate(buses)}
    for line in learned.lines.values():
        bus = index[line.bus]
        if line.table == CHECK:
            yield from _of_check(line, bus, seconds)
        elif line.table == SIGNAL:
            period = periods_s.get((bus, line.name.rpartition(".")[0]), 0.0)
            yield from _of_signal(line, bus, databases[bus], monitor_name(line.bus, SIGNAL, buses), period, seconds)
        elif line.table == RULE:
            yield from _of_rule(line, index, databases, buses)


def _of_check(line: Line, bus: int, seconds: float) -> Iterator[Trial]:
    prefix = f"{line.bus}.{line.name}"
    keys = line.keys

    def trial(kind: str, fault: str) -> Trial:
        return Trial(Injection(kind, bus, line.name, from_s=LEAD_S), f"{prefix}.{fault}", prefix)

    if "timeout_ms" in keys and keys["timeout_ms"] * 1e-3 < seconds - LEAD_S - 0.5:
        yield trial("drop", "timeout")
    if "counter" in keys or "e2e" in keys:
        yield trial("freeze", "counter")
        yield trial("repeat", "counter")
    if {"crc", "checksum", "e2e"} & set(keys):
        yield trial("flip", "crc")


def _of_signal(
    line: Line, bus: int, database: Database, monitor: str, period: float, seconds: float
) -> Iterator[Trial]:
    message, _, name = line.name.rpartition(".")
    signal = database.signal(message, name)
    prefix = f"{monitor}.{line.keys.get('name', name)}"
    low, high = representable(signal)

    def trial(kind: str, value: float, fault: str) -> Trial:
        injection = Injection(kind, bus, message, name, value, LEAD_S)
        return Trial(injection, f"{prefix}.{fault}", f"{line.bus}.{message}")

    step = abs(float(signal.scale))
    if "plausible" in line.keys:
        least, most = line.keys["plausible"]
        codes = no_value(signal)
        for limit, sign, fault, end in ((least, -1, "low", low), (most, 1, "high", high)):
            beyond = limit + sign * max(0.1 * (most - least), 2 * step)
            inside = sign * (end - beyond) >= 0
            if inside and not any(abs(beyond - code) < step for code in codes):
                yield trial("value", beyond, fault)
    if line.keys.get("invalid") == "auto":
        yield trial("value", no_value(signal)[0], "invalid")
    if "gradient" in line.keys:
        size = 1.5 * line.keys["gradient"] * period  # up and down by it is three times the limit
        least, most = line.keys.get("plausible", (low, high))
        if 0 < size < 0.25 * (most - least):
            yield trial("jump", size, "gradient")
    if "share" in line.keys.get("stuck", {}):
        yield trial("stuck", 0.0, "stuck")
    elif "stuck" in line.keys and line.keys["stuck"]["seconds"] < seconds - LEAD_S - 1.0:
        yield trial("stuck", 0.0, "stuck")
    if line.keys.get("undefined"):
        unknown = _undefined(signal)
        if unknown is not None:
            yield trial("value", unknown, "undefined")


def _undefined(signal: Any) -> float | None:
    for raw in range(1 << signal.length):
        if raw not in (signal.choices or {}):
            return float(raw * signal.scale + signal.offset)
    return None


def _of_rule(
    line: Line, index: dict[str, int], databases: Sequence[Database], buses: Sequence[BusAsked]
) -> Iterator[Trial]:
    """Yield an offset of the signal on the left, above the tolerance."""
    left = SIGNAL_NAME.search(line.keys["holds"])
    assert left is not None
    parts = left[0].split(".")
    bus = index[parts[0]] if len(parts) == 3 else index[line.bus]
    message, name = parts[-2:]
    signal = databases[bus].signal(message, name)
    if "tolerance" not in line.keys:
        return
    size = 1.5 * line.keys["tolerance"] + abs(float(signal.scale))
    low, high = representable(signal)
    if 2.5 * size > high - low:
        return
    fault = f"{monitor_name(line.bus, RULE, buses)}.{line.name}"
    yield Trial(Injection("offset", bus, message, name, size, LEAD_S), fault, f"{buses[bus].name}.{message}")


def chosen(all_: Sequence[Trial], most: int, rng: np.random.Generator) -> list[Trial]:
    """Return trials, at most so many, drawn by chance where there are more."""
    if len(all_) <= most:
        return list(all_)
    return [all_[k] for k in np.sort(rng.choice(len(all_), most, replace=False))]


def tried(proof: Replayed, some: Sequence[Trial], seed: int, progress: Callable[[int, int], None]) -> list[Outcome]:
    """Put each fault into the first window that was held out; returns what came of it."""
    if not proof.windows:
        return []
    outcomes = []
    engine = proof.parts.engine
    for number, trial in enumerate(some):
        rng = np.random.default_rng([seed, number])
        # A log ends when it likes: where its window has too few frames of the message, another's may have them.
        best: Outcome | None = None
        for saved, window in zip(proof.before, proof.windows, strict=True):
            outcome = _one(proof, engine, saved, window, trial, rng)
            if best is None or outcome.frames > best.frames:
                best = outcome
            if outcome.named:
                best = outcome
                break
        assert best is not None
        outcomes.append(best)
        progress(number + 1, len(some))
    return outcomes


def _one(
    proof: Replayed, engine: Engine, saved: Engine, window: Frames, trial: Trial, rng: np.random.Generator
) -> Outcome:
    if not len(window):
        return Outcome(trial, 0, named=False, others=())
    restore(engine, saved, proof.config)
    databases, checks = proof.parts.databases, proof.parts.checks
    pgn = [k for k, bus in enumerate(proof.config.bus) if bus.match == "pgn"]
    injector = Injector(trial.injection, databases, checks, rng, int(window["t_ns"][0]), pgn)
    set_: set[str] = set()

    def hear(events: Events) -> None:
        for event in events[events["kind"] == QUALIFIED_FAILED]:
            set_.add(engine.faults[int(event["fault"])].id)

    faulty = injector.apply(window)
    end_ns = int(window["t_ns"].max())
    engine.process(faulty, hear)
    engine.advance(end_ns, hear)
    others = tuple(sorted(set_ - {trial.expected}))
    return Outcome(trial, injector.count, trial.expected in set_, others)
