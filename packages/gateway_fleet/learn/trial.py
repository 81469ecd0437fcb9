"""Trials of the configuration: faults put into frames that it did not learn from, one at a time.

Their sizes come from what a signal itself does, not from its limits: an offset of its own spread, and from there up and
down to the smallest that is seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from cantools.database.can.signal import Signal

from gateway.bus.frames import Frames
from gateway.engine.core import Engine
from gateway_checks.signal.parts import no_value
from gateway_fleet.learn.claims import called_checksum
from gateway_fleet.learn.counters import called_counter
from gateway_fleet.learn.document import SIGNAL_NAME, BusAsked, monitor_name
from gateway_fleet.learn.figures import Everyday, codes_of, everyday
from gateway_fleet.learn.lines import CHECK, RULE, SIGNAL, Learned, Line
from gateway_fleet.learn.observe import Observation, Seen
from gateway_fleet.learn.proof import Replayed
from gateway_fleet.learn.ranges import representable
from gateway_replay.injection import Injection, Injector

#: Time from the cut to the begin of a fault [s]; signals that are tried at most: others are drawn by chance.
LEAD_S, MOST = 1.0, 60
#: Offsets in spreads of the signal, and factors: the first is tried first, then smaller ones if it is seen, else
#: larger.
OFFSETS, SCALES = (1.0, 0.5, 0.25, 2.0, 4.0), (1.3, 2.0, 4.0)
#: How many offsets are smaller than the first, they follow it.
SMALLER = 2
#: Shares between which a signal's spread lies.
SPREAD = (0.05, 0.95)


@dataclass(frozen=True)
class Trial:
    """A fault, and its watchers.

    Attributes:
        injection: the fault.
        watched: ids of faults, and beginnings of such ids (they end with a dot), that are right to be set.
        message: that it is put into, with its bus.
    """

    injection: Injection
    watched: frozenset[str]
    message: str


@dataclass(frozen=True)
class Outcome:
    """Outcome of a trial.

    Attributes:
        trial: it.
        frames: that the fault was in.
        named: whether a watcher of the message or signal was set.
        others: further faults that were set.
        by: fault that was set first; "": none.
        after_s: how long after the fault began [s].
    """

    trial: Trial
    frames: int
    named: bool
    others: tuple[str, ...]
    by: str = ""
    after_s: float = np.nan


@dataclass
class Smallest:
    """Smallest size of a fault that was named at each moment that it was tried at; else the largest size tried.

    Attributes:
        size: unit of the signal.
        named, moments: at how many moments it was named, of how many.
    """

    size: float
    named: int
    moments: int

    @property
    def always(self) -> bool:
        """Whether it was named at each moment."""
        return self.named == self.moments > 0


@dataclass
class Seeing:
    """Visibility of one signal: the smallest fault that was named; None: none was.

    Attributes:
        name: bus, message and signal.
        unit: of it.
        spread: of it.
        up, down: smallest offset seen, up and down.
        scale: factor seen, nearest to one.
        stuck_s: time after which a standing value was seen [s].
    """

    name: str
    unit: str
    spread: float
    up: Smallest | None = None
    down: Smallest | None = None
    scale: Smallest | None = None
    stuck_s: float | None = None


@dataclass
class Trials:
    """All that was tried.

    Attributes:
        outcomes: one fault of each kind and place; its size is that of the signal's own spread.
        seeing: of each signal that is watched.
        everyday: faults of each kind, whether or not anything watches for them.
        unwatched: signals that move, and that nothing watches beside their message's frames.
        left: signals that are watched and were not tried: there were too many.
    """

    outcomes: list[Outcome] = field(default_factory=list)
    seeing: list[Seeing] = field(default_factory=list)
    everyday: list[Everyday] = field(default_factory=list)
    unwatched: list[str] = field(default_factory=list)
    left: int = 0


def watchers(learned: Learned, buses: Sequence[BusAsked]) -> dict[tuple[str, str], set[str]]:
    """Return what watches each (bus.message, signal): ids of faults, or their beginnings; signal "": its frames."""
    found: dict[tuple[str, str], set[str]] = {}
    for line in learned.lines.values():
        if line.table == CHECK:
            found.setdefault((f"{line.bus}.{line.name}", ""), set()).add(f"{line.bus}.{line.name}.")
        elif line.table == SIGNAL:
            message, _, name = line.name.rpartition(".")
            prefix = f"{monitor_name(line.bus, SIGNAL, buses)}.{line.keys.get('name', name)}."
            found.setdefault((f"{line.bus}.{message}", name), set()).add(prefix)
        elif line.table == RULE:
            fault = f"{monitor_name(line.bus, RULE, buses)}.{line.name}"
            for text in SIGNAL_NAME.findall(line.keys["holds"]):
                parts = text.split(".")
                bus = parts[0] if len(parts) == 3 else line.bus
                found.setdefault((f"{bus}.{parts[-2]}", parts[-1]), set()).add(fault)
    return found


def _of_frames(line: Line, bus: int, seconds: float, watched: frozenset[str], moves: bool) -> Iterator[Trial]:
    """Yield faults of a message's frames."""
    keys, name = line.keys, f"{line.bus}.{line.name}"

    def trial(kind: str) -> Trial:
        return Trial(Injection(kind, bus, line.name, from_s=LEAD_S), watched, name)

    if "timeout_ms" in keys and keys["timeout_ms"] * 1e-3 < seconds - LEAD_S - 0.5:
        yield trial("drop")
    if "counter" in keys or "e2e" in keys or moves:
        yield trial("freeze")
        yield trial("repeat")
    if {"crc", "checksum", "e2e"} & set(keys):
        yield trial("flip")


def _codes(line: Line, bus: int, signal: Signal, watched: frozenset[str]) -> Iterator[Trial]:
    """Yield values that stand for none, and values without a text."""
    message = line.name.rpartition(".")[0]

    def trial(value: float) -> Trial:
        injection = Injection("value", bus, message, signal.name, value, LEAD_S)
        return Trial(injection, watched, f"{line.bus}.{message}")

    if line.keys.get("invalid") == "auto" and no_value(signal):
        yield trial(no_value(signal)[0])
    unknown = (raw for raw in range(1 << min(signal.length, 16)) if raw not in (signal.choices or {}))
    if line.keys.get("undefined") and (raw := next(unknown, None)) is not None:
        yield trial(float(raw * signal.scale + signal.offset))


class Bench:
    """Puts faults into the windows that were held out.

    Args:
        proof: the replay that they come from.
        seed: of the faults.
    """

    def __init__(self, proof: Replayed, seed: int) -> None:
        self._proof, self._seed, self.count = proof, seed, 0

    def one(self, trial: Trial) -> Outcome:
        """Put one fault into each window until it is named."""
        # A log ends when it likes: where its window has too few frames of the message, another's may have them.
        best: Outcome | None = None
        for outcome in self.each(trial):
            if best is None or outcome.named or outcome.frames > best.frames:
                best = outcome
            if outcome.named:
                break
        assert best is not None
        return best

    def each(self, trial: Trial) -> Iterator[Outcome]:
        """Put one fault into each window."""
        rng = np.random.default_rng([self._seed, self.count])
        self.count += 1
        for saved, window in zip(self._proof.before, self._proof.windows, strict=True):
            yield _one(self._proof, saved, window, trial, rng)

    def share(self, trial: Trial) -> Smallest:
        """Return at how many moments one fault is named, of those at which its message came."""
        outcomes = [outcome for outcome in self.each(trial) if outcome.frames]
        size = abs(trial.injection.value)
        return Smallest(size, sum(outcome.named for outcome in outcomes), len(outcomes))


def tried(
    proof: Replayed,
    learned: Learned,
    observation: Observation,
    buses: Sequence[BusAsked],
    seed: int,
    progress: Callable[[int, int], None],
) -> Trials:
    """Put faults into what was held out; returns what came of them.

    Args:
        proof: replay of the configuration.
        learned: its lines.
        observation: source of learning.
        buses: as asked for.
        seed: of the faults.
        progress: told how many of how many were tried.
    """
    result = Trials()
    if not proof.windows:
        return result
    result.everyday = everyday(proof, seed, progress)
    index = {bus.name: k for k, bus in enumerate(buses)}
    seconds = max((float(w["t_ns"].max() - w["t_ns"].min()) * 1e-9 for w in proof.windows if len(w)), default=0.0)
    watched, bench = watchers(learned, buses), Bench(proof, seed)
    lines = list(learned.lines.values())
    moving = {(line.bus, line.name.rpartition(".")[0]) for line in lines if "share" in line.keys.get("stuck", {})}
    trials: list[Trial] = []
    for line in lines:
        if line.table == CHECK:
            name = f"{line.bus}.{line.name}"
            ids = frozenset(one for key, some in watched.items() if key[0] == name for one in some)
            trials += _of_frames(line, index[line.bus], seconds, ids, (line.bus, line.name) in moving)
        elif line.table == SIGNAL:
            seen, signal = _of(observation, index[line.bus], line.name)
            if seen is not None and signal is not None:
                key = f"{line.bus}.{seen.message.name}", signal.name
                trials += _codes(line, index[line.bus], signal, frozenset(watched[key]))
    signals = _signals(observation, buses, watched, result)
    rng = np.random.default_rng(seed)
    if len(signals) > MOST:
        result.left = len(signals) - MOST
        signals = [signals[k] for k in np.sort(rng.choice(len(signals), MOST, replace=False))]
    total = len(trials) + len(signals)
    for number, trial in enumerate(trials):
        result.outcomes.append(bench.one(trial))
        progress(number + 1, total)
    matrix = observation.snapshots.matrix()
    for number, (bus, seen, signal, ids) in enumerate(signals):
        column = matrix[:, seen.columns.start + seen.signals.index(signal)]
        _see(result, bench, (buses[bus].name, bus, seen, signal), column, (ids, lines))
        progress(len(trials) + number + 1, total)
    return result


def _of(observation: Observation, bus: int, full: str) -> tuple[Seen | None, Signal | None]:
    message, _, name = full.rpartition(".")
    seen = observation.seen.get((bus, message))
    return seen, None if seen is None else next((each for each in seen.signals if each.name == name), None)


def _signals(
    observation: Observation, buses: Sequence[BusAsked], watched: Mapping[tuple[str, str], set[str]], result: Trials
) -> list[tuple[int, Seen, Signal, frozenset[str]]]:
    """Return the quantities that something watches; the others are reported."""
    found = []
    for (bus, name), seen in observation.seen.items():
        for signal, course in zip(seen.signals, seen.courses.each, strict=True):
            named = called_checksum(signal.name) or called_counter(signal.name) or signal.is_multiplexer
            if named or signal.choices or course.span <= 0.0 or signal.length < 2:
                continue
            ids = watched.get((f"{buses[bus].name}.{name}", signal.name), set())
            if ids:
                found.append((bus, seen, signal, frozenset(ids)))
            else:
                result.unwatched.append(f"{buses[bus].name}.{name}.{signal.name}")
    return found


def _see(
    result: Trials,
    bench: Bench,
    where: tuple[str, int, Seen, Signal],
    column: Any,
    watch: tuple[frozenset[str], Sequence[Line]],
) -> None:
    """Find the smallest faults of one signal that are seen."""
    bus_name, bus, seen, signal = where
    ids, lines = watch
    name = f"{bus_name}.{seen.message.name}"
    good = column[~np.isnan(column)]
    course = seen.courses.each[seen.signals.index(signal)]
    spread = float(np.ptp(np.quantile(good, SPREAD))) if len(good) else 0.0
    spread = max(spread or course.span, abs(float(signal.scale)))
    low, high = representable(signal)
    up = high - course.highest >= course.lowest - low

    def trial(kind: str, value: float) -> Trial:
        return Trial(Injection(kind, bus, seen.message.name, signal.name, value, LEAD_S), ids, name)

    sees = Seeing(f"{name}.{signal.name}", signal.unit or "", spread)
    asks = [line for line in lines if line.bus == bus_name and _asks_size(line, f"{seen.message.name}.{signal.name}")]
    if asks:
        result.outcomes.append(bench.one(trial("offset", spread if up else -spread)))
        sees.up = _smallest(bench, OFFSETS, lambda size: trial("offset", size * spread))
        sees.down = _smallest(bench, OFFSETS, lambda size: trial("offset", -size * spread))
        if any(line.table == RULE for line in asks):
            sees.scale = _smallest(bench, SCALES, lambda factor: trial("scale", factor), smaller=0)
    rests = any("stuck" in line.keys and line.name == f"{seen.message.name}.{signal.name}" for line in lines)
    if not rests and not any(line.table == RULE for line in asks):
        result.seeing.append(sees)  # a value that stands is in its range
        return
    outcome = bench.one(trial("stuck", 0.0))
    sees.stuck_s = outcome.after_s if outcome.named else None
    result.outcomes.append(outcome)
    result.seeing.append(sees)


def _asks_size(line: Line, full: str) -> bool:
    """Return whether a line may see that a signal has another value."""
    if line.table == SIGNAL:
        return line.name == full and bool({"plausible", "gradient"} & set(line.keys))
    return line.table == RULE and full in SIGNAL_NAME.findall(line.keys["holds"])


def _smallest(
    bench: Bench, sizes: Sequence[float], trial: Callable[[float], Trial], smaller: int = SMALLER
) -> Smallest | None:
    """Return the smallest size that is seen at each moment, else the largest one and how often; None: it never is."""
    best = bench.share(trial(sizes[0]))
    seen = best.always
    for size in sizes[1 : 1 + smaller] if seen else sizes[1 + smaller :]:
        other = bench.share(trial(size))
        if seen and not other.always:
            break
        best = other
        if best.always and not seen:
            break
    return best if best.named else None


def _one(proof: Replayed, saved: Engine, window: Frames, trial: Trial, rng: np.random.Generator) -> Outcome:
    if not len(window):
        return Outcome(trial, 0, named=False, others=())
    databases, checks = proof.parts.databases, proof.parts.checks
    pgn = [k for k, bus in enumerate(proof.config.bus) if bus.match == "pgn"]
    start_ns = int(window["t_ns"][0])
    injector = Injector(trial.injection, databases, checks, rng, start_ns, pgn)
    faulty = injector.apply(window)
    set_ = codes_of(proof, saved, faulty) if len(faulty) else {}
    right = [fault for fault in set_ if _is_right(fault, trial.watched)]
    by = min(right, key=lambda fault: set_[fault], default="")
    others = tuple(sorted(set(set_) - {by}))
    late_s = float(int(faulty["t_ns"][0]) - start_ns) * 1e-9 - LEAD_S if by else np.nan
    return Outcome(trial, injector.count, bool(right), others, by, set_.get(by, np.nan) + late_s)


def _is_right(fault: str, watched: frozenset[str]) -> bool:
    return fault in watched or f"{fault.rpartition('.')[0]}." in watched
