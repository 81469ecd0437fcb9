"""One pass over healthy logs: the messages, how often they come, and their contents."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, ID_MASK, Frames, have_data
from gateway.config.model import Config
from gateway.signals.database import Database
from gateway.signals.decode import lookup, of_a_tester
from gateway.signals.payloads import are_last, decode_payloads, payloads_of, valued, words_of
from gateway.signals.reassembly import woven_of
from gateway.signals.tables import compile_plan
from gateway_checks.signal.parts import no_value
from gateway_fleet.learn import observers
from gateway_fleet.learn.course import Courses
from gateway_fleet.learn.gaps import WAKE_MS, Gaps
from gateway_fleet.learn.pauses import Pauses, set_wakes
from gateway_fleet.learn.protection_check import Payloads
from gateway_fleet.learn.samples import Samples
from gateway_fleet.learn.snapshots import Snapshots
from gateway_fleet.learn.unknown import MOST, message_of


@dataclass
class Seen:
    """Observation of one message.

    Attributes:
        bus: index of its bus.
        message: in the database.
        signals: in the order of the columns.
        frames: that came.
        lengths: payload lengths [byte] -> frames.
        gaps: between frames.
        courses: of its signals.
        samples: frames that were kept.
        ended_s: longest time from its last frame to the end of a log [s]; with its time in the log.
        columns: of its signals among all.
        observers: of other packages.
        sources: of J1939: frames of each source address; learned is from those of the first, or of the one that the
            database names.
        unknown: no database has its identifier, but the one that ``learn`` itself makes.
        values: payloads -> its signals in them, shape (frames, signals), as :func:`gateway.signals.payloads.columns`.
    """

    bus: int
    message: Message
    signals: list[Signal]
    columns: slice
    courses: Courses
    frames: int = 0
    lengths: Counter[int] = field(default_factory=Counter)
    gaps: Gaps = field(default_factory=Gaps)
    samples: Samples = field(default_factory=Samples)
    ended_s: float = 0.0
    last_ns: int | None = None
    observers: list[observers.Observer] = field(default_factory=list)
    unknown: bool = False
    sources: Counter[int] = field(default_factory=Counter)
    values: Callable[[Payloads], NDArray[np.float64]] = lambda payloads: np.zeros((len(payloads), 0))


@dataclass
class LogSeen:
    """Data read of one log.

    Attributes:
        path: of it.
        frames: that were learned from.
        first_ns, last_ns: their stamps.
        cut_ns: from here on it was held out; None: nothing was.
    """

    path: Path
    frames: int = 0
    first_ns: int | None = None
    last_ns: int = 0
    cut_ns: int | None = None

    @property
    def seconds(self) -> float:
        """Length of what was learned from [s]."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) * 1e-9


@dataclass
class Observation:
    """All that was seen.

    Attributes:
        seen: messages that came, by bus and name; of the databases, and those of identifiers that none has.
        absent: messages of the databases that did not.
        foreign: (bus, identifier with its flags) -> frames that no database has and no message was made of.
        notes: (bus, line): what there is to know of its databases.
        logs: that were read.
        snapshots: values of all signals at the same times.
        pauses: of each bus as a whole.
    """

    seen: dict[tuple[int, str], Seen]
    absent: list[tuple[int, str]]
    foreign: Counter[tuple[int, int]]
    notes: list[tuple[int, str]]
    logs: list[LogSeen]
    snapshots: Snapshots
    pauses: list[Pauses]


Progress = Callable[[Path, int, float], None]


class Observer:
    """Looks at frames of healthy logs.

    Args:
        config: buses, with their databases and how they match.
        databases: of the buses.
        own: of each bus, the database of identifiers that no other has; None: there is no place for one.

    Attributes:
        plan: of all signals.
    """

    def __init__(self, config: Config, databases: Sequence[Database], own: Sequence[Path | None]) -> None:
        self._config, self._own = config, own
        pgn = [index for index, bus in enumerate(config.bus) if bus.match == "pgn"]
        self.plan = compile_plan(list(enumerate(databases)), pgn=pgn)
        self._woven = woven_of(self.plan)
        of = zip(self.plan.by_pgn, self.plan.named_sources(), strict=True)
        self._sources = [source if group else None for group, source in of]
        self._last_column = 0
        self._rows: dict[int, int] = {}
        self._made = [self._seen(row, databases) for row in range(len(self.plan.message_names))]
        self._foreign: Counter[tuple[int, int]] = Counter()
        self._notes = [(bus, note) for bus, database in enumerate(databases) for note in database.notes]
        self._snapshots = Snapshots(sum(len(seen.signals) for seen in self._made))
        self._logs: list[LogSeen] = []
        self._pauses = [Pauses() for _ in databases]
        places = {(bus, config.ecu[k].place) for bus, ecus in config.answered.items() for k in ecus}
        self._asked = {(bus, each) for bus, place in places for each in (place.request, place.response)}

    def _seen(self, row: int, databases: Sequence[Database]) -> Seen:
        bus, name = self.plan.message_names[row]
        message = databases[bus].message(name)
        by_place = {
            ref.signal: place for ref, place in self.plan.positions.items() if (ref.bus, ref.message) == (bus, name)
        }
        by_name = databases[bus].signals(name)
        signals = [by_name[each] for each in sorted(by_place, key=lambda each: by_place[each])]
        first = self._last_column
        self._last_column = first + len(signals)
        courses = Courses([no_value(signal) for signal in signals])
        names = [signal.name for signal in signals]
        shown = [found for kind in observers.OBSERVERS.values() if (found := kind.of(name, names)) is not None]
        unknown = self._own[bus] is not None and databases[bus].file_of(name) == self._own[bus]
        place = slice(first, self._last_column)
        return Seen(bus, message, signals, place, courses, observers=shown, unknown=unknown, values=self._values(row))

    def _values(self, row: int) -> Callable[[Payloads], NDArray[np.float64]]:
        plan = self.plan
        return lambda some: valued(decode_payloads(some.words, some.lengths, plan, row), plan, row)

    def read(self, path: Path, batches: Iterator[tuple[Frames, float]], hold_out: float, progress: Progress) -> None:
        """Read a log, but for a share at its end.

        Args:
            path: of the log.
            batches: its frames with those of answers, and how far it is then.
            hold_out: the share.
            progress: told how far it is.

        Raises:
            InputError, InputErrors: it is damaged, cut off, or holds no frame of a configured bus.
        """
        log = LogSeen(path)
        self._logs.append(log)
        self._snapshots.begin()
        for pauses in self._pauses:
            pauses.begin()
        for seen in self._made:
            seen.gaps.begin()
            seen.last_ns = None
            for observer in seen.observers:
                observer.begin()
        for frames, cut in _until(batches, 1.0 - hold_out, progress, path):
            good = frames[: len(frames) if cut is None else cut]
            if cut is not None and log.cut_ns is None:
                log.cut_ns = int(frames["t_ns"][cut])
            if len(good):
                self._add(log, good)
        self._end(log)

    def _add(self, log: LogSeen, frames: Frames) -> None:
        frames = frames[have_data(frames)]
        if not len(frames):
            return
        if log.first_ns is None:
            log.first_ns = int(frames["t_ns"][0])
            for seen in self._made:
                seen.courses.begin(log.first_ns)
        log.frames += len(frames)
        log.last_ns = max(log.last_ns, int(frames["t_ns"].max()))
        self._snapshots.grid(int(frames["t_ns"][0]), int(frames["t_ns"][-1]))
        for bus, pauses in enumerate(self._pauses):
            mine = frames[frames["bus"] == bus]
            if len(mine):
                pauses.add(mine["t_ns"], mine["can_id"])
        came = set()
        for row, group in self._groups(frames):
            came.add(row)
            self._add_message(row, group)
        for row, seen in enumerate(self._made):
            if row not in came and seen.signals and seen.frames:
                self._snapshots.rest(seen.columns)
        self._snapshots.end()

    def _groups(self, frames: Frames) -> Iterator[tuple[int, Frames]]:
        """Yield the frames of each message that a database has, in order."""
        keys = frames["bus"].astype(np.int64) << 32 | frames["can_id"]
        order = np.argsort(keys, kind="stable")
        ordered = keys[order]
        starts = np.flatnonzero(np.concatenate([[True], np.diff(ordered) != 0]))
        by_row: dict[int, list[NDArray[np.intp]]] = {}
        for begin, end in zip(starts, [*starts[1:], len(ordered)], strict=True):
            row = self._row(int(ordered[begin]))
            if row < 0:
                key = int(ordered[begin])
                if not self._carries(key >> 32, key & 0xFFFFFFFF):  # of others the messages are among the frames
                    self._foreign[key >> 32, key & 0xFFFFFFFF] += int(end - begin)
            else:
                by_row.setdefault(row, []).append(order[begin:end])
        for row, parts in by_row.items():
            places = parts[0] if len(parts) == 1 else np.sort(np.concatenate(parts))
            yield row, frames[places]

    def _row(self, key: int) -> int:
        found = self._rows.get(key)
        if found is None:
            found = int(lookup(self.plan.keys, self.plan.rows, key >> 32, key & 0xFFFFFFFF))
            self._rows[key] = found = self._unknown(key >> 32, key & 0xFFFFFFFF) if found < 0 else found
        return found

    def _carries(self, bus: int, can_id: int) -> bool:
        """Return whether frames of an identifier are parts of messages."""
        return self._woven is not None and self._woven.carries(bus, can_id)

    def _unknown(self, bus: int, can_id: int) -> int:
        """Return the place of a message for an identifier that no database has, -1 if none is to be made."""
        if self._own[bus] is None or (bus, can_id) in self._asked or self._carries(bus, can_id):
            return -1
        by_pgn = bool(can_id & EXTENDED) and self._config.bus[bus].match == "pgn"
        mine = [seen for seen in self._made if seen.bus == bus]
        made = sum(seen.unknown for seen in mine)
        if by_pgn or of_a_tester(can_id) or made >= MOST:
            return -1
        message = message_of(can_id, {seen.message.name for seen in mine})
        self._made.append(Seen(bus, message, [], slice(0, 0), Courses([]), unknown=True))
        return len(self._made) - 1

    def _add_message(self, row: int, frames: Frames) -> None:
        seen = self._made[row]
        if row < len(self._sources) and self._sources[row] is not None:
            frames = self._of_one_source(seen, row, frames)
            if not len(frames):
                return
        words, lengths = words_of(frames), frames["length"].astype(np.int64)
        if row < len(self.plan.woven):
            words, lengths = payloads_of(frames, self.plan, row)
            frames = frames[are_last(frames)][: len(words)]
        t_ns = frames["t_ns"]
        seen.frames += len(frames)
        seen.last_ns = int(t_ns[-1])
        self._pauses[seen.bus].give(seen.gaps, t_ns)
        found, counts = np.unique(lengths, return_counts=True)
        seen.lengths.update({int(length): int(count) for length, count in zip(found, counts, strict=True)})
        seen.samples.add(words, lengths, t_ns)
        if seen.signals:
            values = valued(decode_payloads(words, lengths, self.plan, row), self.plan, row)
            usual_s = seen.gaps.quantile_ns(0.5) * 1e-9 if seen.gaps.count else 0.0
            seen.courses.add(t_ns, values, usual_s)
            self._snapshots.put(seen.columns, t_ns, values)
            for observer in seen.observers:
                observer.add(values)

    def _of_one_source(self, seen: Seen, row: int, frames: Frames) -> Frames:
        """Return the frames of the source address that is learned from, and count those of all."""
        addresses = frames["can_id"] & 0xFF
        seen.sources.update(addresses.tolist())
        if self._sources[row] == -1:
            self._sources[row] = int(addresses[0])
        mine: Frames = frames[addresses == self._sources[row]]
        return mine

    def _end(self, log: LogSeen) -> None:
        for seen in self._made:
            if seen.last_ns is None:
                continue
            awake_ns = log.last_ns - self._pauses[seen.bus].woke_ns(seen.last_ns)
            if awake_ns > WAKE_MS * 1e6:  # else it may come yet
                seen.ended_s = max(seen.ended_s, (log.last_ns - seen.last_ns) * 1e-9)

    def result(self) -> Observation:
        """Return what was seen."""
        for bus in range(len(self._pauses)):
            set_wakes([seen.gaps for seen in self._made if seen.bus == bus])
        matrix, step_s, every_s = self._snapshots.matrix(), self._snapshots.step_s, self._snapshots.every_s()
        for seen in self._made:
            for k, course in enumerate(seen.courses.each):
                if not course.states or seen.signals[k].is_float:
                    at = seen.columns.start + k
                    course.measure(matrix[:, at], max(round(every_s[at] / step_s), 1))
        return Observation(
            {(seen.bus, seen.message.name): seen for seen in self._made if seen.frames},
            [(seen.bus, seen.message.name) for seen in self._made if not seen.frames],
            self._foreign,
            self._notes,
            self._logs,
            self._snapshots,
            self._pauses,
        )


def _until(
    batches: Iterator[tuple[Frames, float]], share: float, progress: Progress, path: Path
) -> Iterator[tuple[Frames, int | None]]:
    """Yield the batches of a log, and where in them it is held out from; None: not yet."""
    before = 0.0
    for frames, done in batches:
        cut = None
        if done > share:
            at = (share - before) / (done - before) if done > before else 0.0
            cut = min(max(round(at * len(frames)), 0), len(frames) - 1)
        yield frames, cut
        progress(path, len(frames), done)
        if cut is not None:
            return
        before = done


def identifier(can_id: int) -> str:
    """Return an identifier as people write it."""
    return f"0x{can_id & ID_MASK:X}"
