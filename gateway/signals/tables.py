"""From databases to a decode plan: which signals are decoded, and where their values go."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import WOVEN
from gateway.j1939.frame import group_of
from gateway.j1939.transport import LONGEST as LONGEST_WOVEN
from gateway.signals.bits import LONGEST, needed_by, place
from gateway.signals.containers import Container
from gateway.signals.database import Database
from gateway.signals.decode import (
    FLOAT16,
    FLOAT32,
    FLOAT64,
    MESSAGE,
    SIGNAL,
    SIGNED,
    UNSIGNED,
)
from gateway.signals.identity import needs
from gateway.signals.keys import ANY_SOURCE, by_pgn, can_id_of, containers_of, is_woven, key_table
from gateway.signals.ranges import Pairs, Ranges, runs
from gateway_fdi.errors import InputError
from gateway_fdi.jit import COMPILED

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

#: Before the name of a multiplexer's raw number, where its value is another one.
_RAW = "\0"

_FLOATS = {16: FLOAT16, 32: FLOAT32, 64: FLOAT64}

#: Largest magnitude of a floating-point signal whose database gives no range: beyond it a number of 64 bits does not
#: resolve one unit, so that nothing can have been measured.
LARGEST = 1e15


class SignalRef(NamedTuple):
    """Names a signal: index of its bus, message, signal."""

    bus: int
    message: str
    signal: str


@dataclass(frozen=True)
class DecodePlan:
    """The decode tables, and the names of what is in them.

    ``woven``: messages that may come in several frames; ``containers``, by bus and identifier, have PDUs to decode.
    ``keys``/``rows`` are an open-addressed hash from a frame's bus and identifier to the row of its
    message; ``messages``, ``signals`` and ``mux_ids`` as the decode kernels want them.
    """

    keys: NDArray[np.uint64]
    rows: NDArray[np.int32]
    messages: Any
    signals: Any
    mux_ids: NDArray[np.int64]
    slot_names: tuple[SignalRef, ...]
    slot_units: tuple[str, ...]
    slot_message: NDArray[np.int32]
    message_names: tuple[tuple[int, str], ...]
    by_pgn: tuple[bool, ...]
    woven: tuple[bool, ...]
    containers: Mapping[tuple[int, int], Container]
    positions: dict[SignalRef, int]

    @property
    def n_slots(self) -> int:
        """Number of mailbox slots."""
        return len(self.slot_names)

    @property
    def max_signals(self) -> int:
        """Largest number of signals decoded of one message."""
        return int(self.messages["count"].max(initial=0))

    def slot(self, bus: int, message: str, signal: str) -> int:
        """Return the mailbox slot of a signal that was wanted.

        Raises:
            InputError: it was not.
        """
        try:
            return self._slots[SignalRef(bus, message, signal)]
        except KeyError:
            raise InputError("this signal is not decoded", value=f"{message}.{signal}") from None

    @cached_property
    def _slots(self) -> dict[SignalRef, int]:
        return {name: slot for slot, name in enumerate(self.slot_names)}

    @cached_property
    def _rows(self) -> dict[tuple[int, str], int]:
        return {name: row for row, name in enumerate(self.message_names)}

    def position(self, bus: int, message: str, signal: str) -> int:
        """Return the place of a signal among those decoded of its message."""
        return self.positions[SignalRef(bus, message, signal)]

    def is_multiplexed(self, slot: int) -> bool:
        """Return whether frames of its message may come without a signal, by its mailbox slot."""
        first = self.messages["first"][self.slot_message[slot]]
        return bool(self.signals["parent"][first + self.positions[self.slot_names[slot]]] >= 0)

    def named_sources(self) -> list[int]:
        """Return for each message the source address whose frames it has; -1: of the first that comes.

        A database that describes a group of J1939 for several sources names them.
        """
        ids = self.messages["can_id"]
        keys = [(int(bus), int(group)) for bus, group in zip(self.messages["bus"], group_of(ids), strict=True)]
        count = Counter(key for key, group in zip(keys, self.by_pgn, strict=True) if group)
        return [
            int(can_id & 0xFF) if group and count[key] > 1 and can_id & 0xFF != ANY_SOURCE else -1
            for can_id, key, group in zip(ids, keys, self.by_pgn, strict=True)
        ]

    def beyond(self, row: int, length: int) -> list[str]:
        """Return the signals of a message that are beyond the end of frames of a length, of those that are decoded."""
        first, count = self.messages["first"][row], self.messages["count"][row]
        mine = self.signals[first : first + count].view(np.recarray)
        need = getattr(needed_by, "py_func", needed_by)
        return [self.slot_names[s.slot].signal for s in mine if s.slot >= 0 and need(s) > length]

    def message(self, bus: int, name: str) -> int:
        """Return the row of a message."""
        return self._rows[bus, name]

    def parts(self, row: int) -> int:
        """Return how many frames of 64 bytes a message has at most: more than one only if it is woven."""
        longest = LONGEST_WOVEN if self.woven[row] else LONGEST
        return max(-(-min(int(self.messages[row]["length"]), longest) // LONGEST), 1)

    def identifiers(self, bus: int) -> list[int] | None:
        """Return the identifiers (with EXTENDED) of a bus's messages; None if some match by PGN."""
        mine = [row for row, (index, _) in enumerate(self.message_names) if index == bus]
        if any(self.by_pgn[row] for row in mine):
            return None
        ids = {int(self.messages["can_id"][row]) for row in mine}
        ids |= {can_id for index, can_id in self.containers if index == bus}
        return sorted(can_id for can_id in ids if can_id & WOVEN != WOVEN)


def _valid_range(signal: Signal) -> tuple[float, float]:
    """Return between which values a floating-point signal is valid: its range, and as much again on each side."""
    low, high = signal.minimum, signal.maximum
    if low is None or high is None or not float(low) < float(high):
        return -LARGEST, LARGEST
    span = float(high) - float(low)
    return max(float(low) - span, -LARGEST), min(float(high) + span, LARGEST)


def signal_row(signal: Signal) -> Any:
    """Return the record of SIGNAL of one signal, not multiplexed, for the encode kernel."""
    row = np.zeros(1, SIGNAL)[0]
    place(row, signal.start, signal.length, big=signal.byte_order == "big_endian")
    if signal.is_float:
        row["kind"] = _FLOATS[signal.length]
        row["low"], row["high"] = _valid_range(signal)
    else:
        row["kind"] = SIGNED if signal.is_signed else UNSIGNED
    row["scale"], row["offset"] = signal.scale, signal.offset
    row["slot"] = row["parent"] = row["into"] = -1
    return row


def compile_plan(
    databases: Sequence[tuple[int, Database]],
    wanted: Collection[SignalRef] | None = None,
    *,
    messages: Collection[tuple[int, str]] = (),
    pgn: Collection[int] = (),
) -> DecodePlan:
    """Compile the decode tables.

    Args:
        databases: (bus index, database) pairs.
        wanted: signals to decode; None: all of them that have at most 64 bits.
        messages: (bus index, name) of messages that get a row although none of their signals is
            wanted: their arrival matters.
        pgn: buses whose extended identifiers all match by PGN. Messages that their database calls
            J1939 do so in any case.

    Raises:
        InputError: a name that no database has, a signal longer than 64 bits, two messages with one
            identity.
    """
    by_bus = dict(databases)
    if wanted is None:
        wanted = _all_signals(databases)
        messages = [(bus, message.name) for bus, database in databases for message in database]
    asked = _asked(by_bus, wanted, messages)
    chosen = sorted(
        ((bus, by_bus[bus].message(name)) for bus, name in asked),
        key=lambda pair: (pair[0], pair[1].is_extended_frame, pair[1].frame_id, pair[1].name),
    )
    woven = [is_woven(message, bus in pgn) for bus, message in chosen]
    rows = _Rows(np.zeros(len(chosen), MESSAGE), woven)
    for row, (bus, message) in enumerate(chosen):
        rows.add(row, bus, message, asked[bus, message.name], by_bus[bus].joined(message.name))
    by_group = [by_pgn(message, bus in pgn) for bus, message in chosen]
    keys, places = key_table(chosen, by_group, woven)
    signals = np.asarray(rows.signals, SIGNAL) if rows.signals else np.zeros(0, SIGNAL)
    return DecodePlan(
        keys,
        places,
        rows.messages if COMPILED else rows.messages.view(np.recarray),
        signals if COMPILED else signals.view(np.recarray),
        np.asarray(rows.mux_ids or [(0, 0)], np.int64),
        tuple(rows.slots),
        tuple(rows.units),
        np.asarray(rows.slot_message, np.int32),
        tuple((bus, message.name) for bus, message in chosen),
        tuple(by_group),
        tuple(woven),
        containers_of(databases, chosen),
        rows.positions,
    )


def _all_signals(databases: Sequence[tuple[int, Database]]) -> list[SignalRef]:
    """Return all signals that can be decoded."""
    return [
        SignalRef(bus, message.name, name)
        for bus, database in databases
        for message in database
        for name, signal in database.signals(message.name).items()
        if signal.length <= 64
    ]


def _asked(
    databases: Mapping[int, Database],
    wanted: Collection[SignalRef],
    messages: Collection[tuple[int, str]],
) -> dict[tuple[int, str], set[str]]:
    """Return what is wanted of each message: (bus, name) -> names of signals.

    Raises:
        InputError: a name that no database has, a signal longer than 64 bits.
    """
    asked: dict[tuple[int, str], set[str]] = {key: set() for key in messages}
    for ref in wanted:
        signal = databases[ref.bus].signal(ref.message, ref.signal)
        if signal.length > 64:
            raise InputError(
                "a signal of more than 64 bits cannot be decoded",
                key=f"{ref.message}.{ref.signal}",
                value=signal.length,
            )
        asked.setdefault((ref.bus, ref.message), set()).add(ref.signal)
    return asked


@dataclass
class _Rows:
    """The plan's rows while they are made.

    Attributes:
        messages: of MESSAGE, shape (messages,).
        woven: whether each may come in several frames.
        signals: of SIGNAL; those of one message lie together.
        mux_ids: ranges of multiplexer values that the signals' rows point to.
        slots: the signal of each mailbox slot, with its unit and the row of its message.
        positions: signal -> its place among those of its message.
    """

    messages: NDArray[np.void]
    woven: Sequence[bool]
    signals: list[Any] = field(default_factory=list)
    mux_ids: list[tuple[int, int]] = field(default_factory=list)
    slots: list[SignalRef] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    slot_message: list[int] = field(default_factory=list)
    positions: dict[SignalRef, int] = field(default_factory=dict)

    def add(
        self, row: int, bus: int, message: Message, names: set[str], joined: Mapping[str, tuple[Signal, ...]]
    ) -> None:
        """Fill the row of a message, and those of the signals that it needs for the named ones."""
        needed = _Needed(message, names, joined)
        entry = self.messages[row]
        entry["first"], entry["count"] = len(self.signals), len(needed.places)
        entry["can_id"], entry["bus"] = can_id_of(message), bus
        signals = [signal for signal in needed.places.values() if signal is not None]
        entry["length"] = max([message.length, *map(needs, signals)])
        entry["floats"] = any(signal.is_float for signal in signals)
        alone = not any(signal.is_float or signal.is_multiplexer or signal.multiplexer_ids for signal in signals)
        longest = LONGEST_WOVEN if self.woven[row] else LONGEST
        alone = alone and all(needs(signal) <= longest for signal in signals)
        entry["whole"], entry["slot"] = alone and names >= needed.places.keys(), len(self.slots)
        for at, (name, signal) in enumerate(needed.places.items()):
            there = signal is not None and needs(signal) <= longest  # else no frame has it
            made = self._signal(needed, name, signal) if signal is not None and there else _empty_row()
            if name in names:
                ref = SignalRef(bus, message.name, name)
                self.positions[ref] = at
                made["slot"] = len(self.slots)
                self.slots.append(ref)
                self.units.append(_unit(joined.get(name, (signal,))))
                self.slot_message.append(row)
            self.signals.append(made)

    def _signal(self, needed: _Needed, name: str, signal: Signal) -> Any:
        """Return the row of a signal, its multiplexing resolved to places of the message's other signals."""
        entry = signal_row(signal)
        if name.startswith(_RAW):
            entry["kind"], entry["scale"], entry["offset"] = UNSIGNED, 1.0, 0.0
        if signal.multiplexer_signal is not None:
            entry["parent"] = needed.place(needed.selector[signal.multiplexer_signal])
            entry["first_id"], entry["ids"] = self._ids(signal.multiplexer_ids or [])
        if name in needed.selector.values():
            entry["first_known"], entry["known"] = self._ids(needed.known(signal))
        if name in needed.into:
            entry["into"] = needed.place(needed.into[name])
        number = entry["kind"] == UNSIGNED and entry["length"] < 64 and not (entry["big"] or entry["spill"])
        entry["plain"] = number and entry["parent"] < 0 and entry["known"] == 0 and entry["into"] < 0
        return entry

    def _ids(self, values: Iterable[int]) -> tuple[int, int]:
        """Append multiplexer values; returns where their ranges begin, and how many they are."""
        begin, made = len(self.mux_ids), runs(values)
        self.mux_ids += made
        return begin, len(made)


class _Needed:
    """Signals of a message that are decoded for some of them: also all multiplexers.

    Args:
        message: of the database.
        names: of the signals that are wanted, exact ones, or joined ones.
        joined: names that several signals share -> these.

    Attributes:
        places: name -> signal, each multiplexer before what it selects; None: the place of several of one name, which
            lies before theirs. A multiplexer whose value is not its raw number has another place for that.
        selector: name of a multiplexer as the database refers to it -> name of the place of its raw number.
        into: name of the place of a signal -> name of the place that has its value, too.
    """

    def __init__(self, message: Message, names: set[str], joined: Mapping[str, tuple[Signal, ...]]) -> None:
        self.places: dict[str, Signal | None] = {}
        self.selector: dict[str, str] = {}
        self.into: dict[str, str] = {}
        self._by_name, self._joined = {signal.name: signal for signal in message.signals}, joined
        of = {signal.name: name for name, each in joined.items() for signal in each}
        for signal in message.signals:
            if signal.is_multiplexer:
                self._select(of.get(signal.name, signal.name))
            if of.get(signal.name) in names:
                self._join(of[signal.name], "")
            if signal.name in names:
                self._take(signal)
        self._places = {name: place for place, name in enumerate(self.places)}

    def place(self, name: str) -> int:
        """Return the place of a name."""
        return self._places[name]

    def known(self, multiplexer: Signal) -> Ranges:
        """Return the values of a multiplexer that the database describes, anywhere in the message; none: any."""
        found: Pairs = [(int(value), int(value)) for value in multiplexer.choices or {}]
        for signal in self._by_name.values():
            if signal.multiplexer_signal == multiplexer.name:
                found += runs(signal.multiplexer_ids or [])
        return Ranges(found)

    def _take(self, signal: Signal, prefix: str = "") -> None:
        if signal.multiplexer_signal is not None:
            self._select(signal.multiplexer_signal)
        self.places.setdefault(f"{prefix}{signal.name}", signal)

    def _join(self, name: str, prefix: str) -> None:
        if f"{prefix}{name}" not in self.places:
            for signal in self._joined[name]:
                if signal.multiplexer_signal is not None:
                    self._select(signal.multiplexer_signal)
            self.places[f"{prefix}{name}"] = None
            for signal in self._joined[name]:
                self._take(signal, prefix)
                self.into[f"{prefix}{signal.name}"] = f"{prefix}{name}"

    def _select(self, name: str) -> None:
        """Take a multiplexer for its raw number."""
        if name in self.selector:
            return
        signal = self._by_name.get(name)
        if signal is None:
            self.selector[name] = f"{_RAW}{name}"
            if name in self._joined:
                self._join(name, _RAW)
            else:  # the database has no such signal: what it selects is never there
                self.places[f"{_RAW}{name}"] = None
            return
        plain = not signal.is_float and not signal.is_signed and (signal.scale, signal.offset) == (1, 0)
        self.selector[name] = name if plain else f"{_RAW}{name}"
        self._take(signal, "" if plain else _RAW)


def _empty_row() -> Any:
    """Return the record of SIGNAL of a place without bits: several signals of one name put their value there."""
    row = np.zeros(1, SIGNAL)[0]
    row["slot"] = row["into"] = -1
    row["length"] = 1
    return row


def _unit(signals: Sequence[Signal | None]) -> str:
    """Return the unit of a slot; signals of several units have none together."""
    units = {signal.unit or "" for signal in signals if signal is not None}
    return units.pop() if len(units) == 1 else ""


def encode_rows(message: Message, names: Sequence[str]) -> list[Any]:
    """Return records of SIGNAL, in the order of ``names``, for the encode kernel.

    Raises:
        InputError: no such signal, a multiplexed one, one that is no integer or has more than 64 bits.
    """
    by_name = {signal.name: signal for signal in message.signals}
    rows = []
    for name in names:
        signal = by_name.get(name)
        if signal is None:
            raise InputError(f"the message has no signal {name!r}", key=message.name)
        if signal.multiplexer_ids or signal.is_float or signal.length > 64:
            raise InputError(
                "a signal to be sent is an integer of at most 64 bits that is always there",
                key=f"{message.name}.{name}",
            )
        rows.append(signal_row(signal))
    return rows
