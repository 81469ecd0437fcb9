"""Everyday faults put into a drive of a vehicle, and the components that are right to be named for each.

A fault is put in whether or not anything watches for it: its size is that of the workshop, not that of a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.bus.frames import ID_MASK, Frames
from gateway.config.model import Config
from gateway.engine.depends.parts import Network
from gateway.runtime.assemble import Parts
from gateway.signals.protection.params import protection_for
from gateway.signals.protection.protection import Protection
from gateway.signals.signal_access import ChangedMessage, ChangedSignal
from gateway_fleet.learn.claims import called_checksum
from gateway_fleet.learn.counters import called_counter
from gateway_fleet.learn.course import MOST_VALUES
from gateway_fleet.learn.limits import texts_of
from gateway_fleet.learn.stuck_detection import UNITS
from gateway_replay.injection import Injection, Injector

#: When a fault begins and ends, in shares of the drive; an ECU reboots, and a bus is away [s].
BEGIN, END, REBOOT_S, AWAY_S = 0.3, 0.75, 2.0, 3.0
#: Offsets: of a speed [km/h]; of others as a share of what the signal spans. Factor; end of a drift, of that span.
SPEED_KMH, WHEEL_KMH, SHARE, FACTOR, DRIFT = 7.0, 8.0, 0.25, 2.0, 0.4
#: A signal whose middle change is farther than this share of its span is a code; two that are swapped differ by it.
JUMPS = 0.1
#: Jitter in cycles, and one frame of LOST is lost.
CYCLES, LOST = 3.0, 10
#: Messages of an ECU where no database names senders; frames of a message at least; signals of the same kind that are
#: wheels.
OF_ECU, LEAST, WHEELS = 3, 20, 4
#: Kinds that are told by the bus, or as a security event.
AWAY, UNKNOWN = "bus away", "unknown identifier"
#: A km/h [m/s].
_KMH = 1 / 3.6


@dataclass(frozen=True)
class Fault:
    """A fault in a drive.

    Attributes:
        kind: one of KINDS.
        about: what it is put into, for people.
        frames: the drive with it.
        begin_ns, end_ns: when it begins and ends.
        needs_s: how long it has to last until a limit of the configuration is beyond [s]; infinite: it has none.
        right: components of which one is to be named.
        concerned: components, and messages with a dot behind them, that may be named beside it.
    """

    kind: str
    about: str
    frames: Frames
    begin_ns: int
    end_ns: int
    needs_s: float
    right: frozenset[str]
    concerned: frozenset[str]

    @property
    def of_message(self) -> bool:
        """Whether it is one of the vehicle's messages, and not of the whole bus or of a stranger on it."""
        return self.kind not in (AWAY, UNKNOWN)


@dataclass(frozen=True)
class _Sent:
    """A message as a drive has it: bus, name, middle gap between two frames [ns], its frames, ECUs that send it."""

    bus: int
    name: str
    cycle_ns: int
    count: int
    senders: tuple[str, ...]


class Drive:
    """A healthy drive that faults are put into.

    Args:
        config: that was learned.
        parts: of it.
        frames: of the drive, in order of time.
        rng: source of all randomness.
    """

    def __init__(self, config: Config, parts: Parts, frames: Frames, rng: np.random.Generator) -> None:
        self.frames, self.rng, self._parts = frames, rng, parts
        self.names = [bus.name for bus in config.buses]
        self._pgn = [k for k, bus in enumerate(config.buses) if bus.match == "pgn"]
        self._network = Network(self.names, dict(enumerate(parts.databases)))
        self.start_ns, end_ns = int(frames["t_ns"][0]), int(frames["t_ns"][-1])
        self.seconds = (end_ns - self.start_ns) * 1e-9
        self.sent = list(self._messages())
        self.known = {message.frame_id for database in parts.databases for message in database}
        self.known.update((frames["can_id"] & ID_MASK).tolist())

    def _messages(self) -> Iterator[_Sent]:
        for bus, database in enumerate(self._parts.databases):
            for message in database:
                mine = self.frames["t_ns"][self._changed(bus, message.name).among(self.frames)]
                if len(mine) >= LEAST:
                    senders = tuple(one.name for one in self._network.senders(bus, message.name))
                    yield _Sent(bus, message.name, int(np.median(np.diff(mine))), len(mine), senders)

    def _changed(self, bus: int, name: str) -> ChangedMessage:
        database = self._parts.databases[bus]
        mine = [check for check in self._parts.checks if (check.bus, check.params.message) == (bus, name)]
        protection = protection_for(database.message(name), mine[0].params) if mine else Protection()
        return ChangedMessage(bus, database, name, protection, self._pgn)

    def any_message(self) -> _Sent | None:
        """Return a message by chance; None: the drive has none."""
        return self.sent[int(self.rng.integers(len(self.sent)))] if self.sent else None

    def any_ecu(self) -> list[_Sent]:
        """Return the messages of an ECU by chance, where no sender is named some messages."""
        ecus = sorted({sender for one in self.sent for sender in one.senders})
        if ecus:
            ecu = ecus[int(self.rng.integers(len(ecus)))]
            return [one for one in self.sent if one.senders == (ecu,)]
        places = self.rng.permutation(len(self.sent))[:OF_ECU]
        return [self.sent[k] for k in places]

    def quantities(self) -> Iterator[tuple[_Sent, Signal, NDArray[np.float64]]]:
        """Yield quantities that move, with their values, in an order by chance: no state, code, counter or checksum.

        A quantity goes from value to value: what jumps as far in the middle as JUMPS of its span is a code.
        """
        for sent, signal in self._signals():
            named = called_checksum(signal.name) or called_counter(signal.name) or signal.is_multiplexer
            if named or signal.choices or signal.length < 2 or self._protects(sent, signal.name):
                continue
            values = self.values(sent, signal.name)
            steps = np.abs(np.diff(values))
            steps = steps[steps > 0.0]
            many = len(values) >= LEAST and len(np.unique(values)) > MOST_VALUES
            if many and np.median(steps) <= JUMPS * np.ptp(values):
                yield sent, signal, values

    def _protects(self, sent: _Sent, signal: str) -> bool:
        """Return whether a signal is the counter or checksum of its message, as the configuration has it."""
        for check in self._parts.checks:
            if (check.bus, check.params.message) == (sent.bus, sent.name):
                asked = check.params.model_dump()
                return any(isinstance(part, dict) and part.get("signal") == signal for part in asked.values())
        return False

    def texts(self) -> Iterator[tuple[_Sent, Signal]]:
        """Yield signals whose values have texts, all of them, and that could say one without, in an order by chance.

        A quantity of which the database names a code or two is none: any value may come.
        """
        for sent, signal in self._signals():
            some = signal.choices and not signal.is_multiplexer and len(signal.choices) < 1 << signal.length
            if some and set(np.unique(self.values(sent, signal.name)).tolist()) <= texts_of(signal):
                yield sent, signal

    def _signals(self) -> Iterator[tuple[_Sent, Signal]]:
        some = [(one, s) for one in self.sent for s in self._parts.databases[one.bus].message(one.name).signals]
        for k in self.rng.permutation(len(some)).tolist():
            yield some[k]

    def values(self, sent: _Sent, signal: str) -> NDArray[np.float64]:
        """Return what a signal has in the drive, where it is."""
        mine = self.frames[self.of(sent)]
        values = ChangedSignal(sent.bus, self._parts.databases[sent.bus], sent.name, signal).values(mine)
        return values[~np.isnan(values)]

    def injected(self, kind: str, sent: _Sent, signal: str | None = None, value: float = 0.0) -> Injection:
        """Return a fault of a message or signal, from BEGIN to END."""
        first, last = BEGIN * self.seconds, END * self.seconds
        return Injection(kind, sent.bus, sent.name, signal, value, first, last)

    def with_(self, injections: list[Injection]) -> Frames:
        """Return the drive with faults put in."""
        frames = self.frames
        for asked in injections:
            how = (self._parts.databases, self._parts.checks, self.rng, self.start_ns, self._pgn)
            frames = Injector(asked, *how).apply(frames)
        return frames

    def hit(self, sent: _Sent) -> NDArray[np.bool_]:
        """Return which frames of a message come while a fault is there, shape (frames,)."""
        shares = (self.frames["t_ns"] - self.start_ns) * 1e-9 / self.seconds
        within = np.asarray((shares >= BEGIN) & (shares < END), np.bool_)
        return within & self.of(sent)

    def of(self, sent: _Sent) -> NDArray[np.bool_]:
        """Return which frames are of a message, shape (frames,)."""
        return self._changed(sent.bus, sent.name).among(self.frames)

    def swapped(self, sent: _Sent, first: str, second: str) -> Frames:
        """Return the drive with two signals of a message swapped; its checksum is right."""
        frames, message = self.frames.copy(), self._changed(sent.bus, sent.name)
        places = np.flatnonzero(self.hit(sent))
        mine = frames[places]
        words = np.ascontiguousarray(mine["data"]).view("<u8").reshape(len(mine), 8)
        both = [ChangedSignal(sent.bus, self._parts.databases[sent.bus], sent.name, name) for name in (first, second)]
        values = [one.values(mine) for one in both]
        where = ~np.isnan(values[0]) & ~np.isnan(values[1])
        both[0].put_all(words, values[1], where)
        both[1].put_all(words, values[0], where)
        message.renew_all(words, mine["length"].astype(np.int64), where)
        mine["data"] = words.view(np.uint8).reshape(mine["data"].shape)
        frames[places] = mine
        return frames

    def fault(
        self,
        kind: str,
        about: str,
        frames: Frames,
        right: set[str],
        messages: list[_Sent],
        *,
        lasts_s: float | None = None,
        needs_s: float = 0.0,
    ) -> Fault:
        """Return a fault of messages, or of signals in them; ``lasts_s``: None: until END."""
        lasts_s = (END - BEGIN) * self.seconds if lasts_s is None else lasts_s
        begin_ns = self.start_ns + round(BEGIN * self.seconds * 1e9)
        named = {f"{self.names[one.bus]}.{one.name}" for one in messages}
        senders = {s for one in messages for s in one.senders or (self._network.unnamed(one.bus).name,)}
        concerned = right | {f"message {name}" for name in named} | senders | {f"signal {name}." for name in named}
        end_ns = begin_ns + round(lasts_s * 1e9)
        return Fault(kind, about, frames, begin_ns, end_ns, needs_s, frozenset(right), frozenset(concerned))

    def needs_s(self, kind: str, messages: list[_Sent]) -> float:
        """Return how long a fault of messages has to last until a limit is beyond [s]; infinite: none watches.

        A timeout is over, or frames that come twice as often fill a window in half of its time. Of a message that is
        sent at a change, too, only those count that repeat a content, or its counter runs twice.
        """
        names = {(one.bus, one.name) for one in messages}
        mine = [check.params for check in self._parts.checks if (check.bus, check.params.message) in names]
        if kind == "drop":
            times = [one.timeout_ms for one in mine]
        elif kind in ("double", "replay"):
            counted = [one for one in mine if one.most and (kind == "double" or one.counter or not one.most.repeats)]
            times = [0.5 * one.most.ms for one in counted if one.most]
        else:
            return 0.0
        return min((1e-3 * ms for ms in times if ms is not None), default=inf)

    def place(self, sent: _Sent, signal: str = "") -> str:
        """Return the name of a message or signal."""
        return ".".join([self.names[sent.bus], sent.name, *([signal] if signal else [])])

    def unnamed(self, sent: _Sent) -> set[str]:
        """Return the ECU that stands for all whose sender nobody names."""
        return {self._network.unnamed(sent.bus).name}

    def carriers(self, sent: _Sent) -> set[str]:
        """Return the components that are at fault where a message's frames are: itself, or an ECU with no other."""
        alone = {s for s in sent.senders if sum(s in one.senders for one in self.sent) == 1}
        return {f"message {self.place(sent)}"} | alone


def _frames(kind: str, name: str) -> Callable[[Drive], Fault | None]:
    """Return a fault of a message's frames, as an injection has it."""

    def make(drive: Drive) -> Fault | None:
        if (sent := drive.any_message()) is None:
            return None
        frames = drive.with_([drive.injected(kind, sent)])
        beside = kind in ("double", "replay")
        right = {f"second sender {drive.place(sent)}"} if beside else drive.carriers(sent)
        needs_s = drive.needs_s(kind, [sent])
        return drive.fault(name, drive.place(sent), frames, right, [sent], needs_s=needs_s)

    return make


def _lost(drive: Drive) -> Fault | None:
    if (sent := drive.any_message()) is None:
        return None
    hit = np.flatnonzero(drive.hit(sent))
    frames = np.delete(drive.frames, hit[int(drive.rng.integers(LOST)) :: LOST])
    return drive.fault("one of ten lost", drive.place(sent), frames, drive.carriers(sent), [sent])


def _jitter(drive: Drive) -> Fault | None:
    if (sent := drive.any_message()) is None:
        return None
    frames, mine = drive.frames.copy(), drive.of(sent)
    frames["t_ns"] += drive.hit(sent) * drive.rng.integers(0, max(1, round(CYCLES * sent.cycle_ns)), len(frames))
    frames["t_ns"][mine] = np.sort(frames["t_ns"][mine])  # no frame of a message overtakes another
    frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    return drive.fault("jitter", drive.place(sent), frames, drive.carriers(sent), [sent])


def _ecu(name: str, lasts_s: float | None) -> Callable[[Drive], Fault | None]:
    def make(drive: Drive) -> Fault | None:
        mine = drive.any_ecu()
        drops = [drive.injected("drop", one) for one in mine]
        if lasts_s is not None:
            drops = [replace(one, to_s=one.from_s + lasts_s) for one in drops]
        if not mine or (lasts_s is not None and min(one.cycle_ns for one in mine) > lasts_s * 0.5e9):
            return None
        parts = {f"message {drive.place(one)}" for one in mine}
        ecu = set(mine[0].senders) or drive.unnamed(mine[0])
        right = ecu if mine[0].senders and len(mine) > 1 else parts | ecu
        about, needs_s = ", ".join(drive.place(one) for one in mine), drive.needs_s("drop", mine)
        return drive.fault(name, about, drive.with_(drops), right, mine, lasts_s=lasts_s, needs_s=needs_s)

    return make


def _away(drive: Drive) -> Fault | None:
    bus = int(drive.rng.integers(len(drive.names)))
    since_s = (drive.frames["t_ns"] - drive.start_ns) * 1e-9 - BEGIN * drive.seconds
    gone = (drive.frames["bus"] == bus) & (since_s >= 0.0) & (since_s < AWAY_S)
    if not gone.any():
        return None
    mine = [one for one in drive.sent if one.bus == bus]
    right = {f"bus {drive.names[bus]}"}
    return drive.fault(AWAY, drive.names[bus], drive.frames[~gone], right, mine, lasts_s=AWAY_S)


def _unknown(drive: Drive) -> Fault | None:
    new = hex(next(k for k in drive.rng.integers(1, 0x6FF, 2000).tolist() if k not in drive.known))
    asked = Injection("unknown", 0, new, from_s=BEGIN * drive.seconds, to_s=END * drive.seconds)
    return drive.fault(UNKNOWN, new, drive.with_([asked]), set(), [])


def _value(
    name: str, kind: str, size: Callable[[Signal, NDArray[np.float64], float], float]
) -> Callable[..., Fault | None]:
    """Return a fault of a signal's value; ``size`` is told the signal, its values, and how long the fault lasts [s]."""

    def make(drive: Drive) -> Fault | None:
        for sent, signal, values in drive.quantities():
            value = size(signal, values, (END - BEGIN) * drive.seconds)
            frames = drive.with_([drive.injected(kind, sent, signal.name, value)])
            if np.array_equal(frames, drive.frames):
                continue  # its bits cannot say it
            told = f"{drive.place(sent, signal.name)} {value:+.4g}" if value else drive.place(sent, signal.name)
            return drive.fault(name, told, frames, {f"signal {drive.place(sent, signal.name)}"}, [sent])
        return None

    return make


def _offset(signal: Signal, values: NDArray[np.float64], _seconds: float) -> float:
    return SPEED_KMH * _KMH / UNITS[str(signal.unit).lower()] if _is_speed(signal) else SHARE * float(np.ptp(values))


def _is_speed(signal: Signal) -> bool:
    return str(signal.unit).lower() in UNITS


def _wheel(drive: Drive) -> Fault | None:
    alike: dict[tuple[object, ...], list[tuple[_Sent, Signal]]] = {}
    for sent, signal, _ in drive.quantities():
        key = sent.bus, signal.unit, signal.length, signal.scale, "wheel" in f"{sent.name}{signal.name}".lower()
        if _is_speed(signal):
            alike.setdefault(key, []).append((sent, signal))
    for some in alike.values():
        if len(some) >= WHEELS:
            sent, signal = some[0]
            value = WHEEL_KMH * _KMH / UNITS[str(signal.unit).lower()]
            frames = drive.with_([drive.injected("offset", sent, signal.name, value)])
            name = drive.place(sent, signal.name)
            return drive.fault("wheel off", f"{name} {value:+.4g}", frames, {f"signal {name}"}, [sent])
    return None


def _swap(drive: Drive) -> Fault | None:
    by: dict[tuple[object, ...], list[tuple[_Sent, str, NDArray[np.float64]]]] = {}
    for sent, signal, values in drive.quantities():
        some = by.setdefault((sent, signal.length, signal.scale, signal.offset, signal.is_signed), [])
        for _, other, before in some:
            if len(before) == len(values) and np.median(np.abs(values - before)) >= JUMPS * np.ptp(values):
                places = [drive.place(sent, name) for name in (other, signal.name)]
                frames = drive.swapped(sent, other, signal.name)
                return drive.fault("swapped", " and ".join(places), frames, {f"signal {p}" for p in places}, [sent])
        some.append((sent, signal.name, values))
    return None


def _text(drive: Drive) -> Fault | None:
    for sent, signal in drive.texts():
        raw = next(k for k in range(1 << signal.length) if k not in (signal.choices or {}))
        value = float(raw * signal.scale + signal.offset)
        frames = drive.with_([drive.injected("value", sent, signal.name, value)])
        name = drive.place(sent, signal.name)
        return drive.fault("undefined text", f"{name} = {raw}", frames, {f"signal {name}"}, [sent])
    return None


#: Kind of a fault -> what makes one in a drive; None: this drive has no place for it.
KINDS: dict[str, Callable[[Drive], Fault | None]] = {
    "ECU dead": _ecu("ECU dead", None),
    "ECU reboots": _ecu("ECU reboots", REBOOT_S),
    "dropped": _frames("drop", "dropped"),
    AWAY: _away,
    "second sender": _frames("double", "second sender"),
    "replayed": _frames("replay", "replayed"),
    UNKNOWN: _unknown,
    "frozen": _frames("freeze", "frozen"),
    "repeated": _frames("repeat", "repeated"),
    "bit flipped": _frames("flip", "bit flipped"),
    "one of ten lost": _lost,
    "jitter": _jitter,
    "stuck": _value("stuck", "stuck", lambda _signal, _values, _seconds: 0.0),
    "offset": _value("offset", "offset", _offset),
    "scale": _value("scale", "scale", lambda _signal, _values, _seconds: FACTOR),
    "drift": _value("drift", "drift", lambda _signal, values, seconds: DRIFT * float(np.ptp(values)) / seconds),
    "wheel off": _wheel,
    "swapped": _swap,
    "undefined text": _text,
}
