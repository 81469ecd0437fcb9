"""CAN databases: DBC, KCD, SYM and ARXML files through cantools, with errors a user can mend."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.j1939.frame import group_of
from gateway.j1939.transport import LONGEST as LONGEST_WOVEN
from gateway.signals.bits import LONGEST
from gateway.signals.bounds import refuse_lengths, refuse_scalings
from gateway.signals.containers import CONTAINED, contained_in, with_short_headers
from gateway.signals.database_cache import messages_of
from gateway.signals.dialect import mended, signals_said, text_of, without
from gateway.signals.identity import (
    exact_name,
    exact_signals,
    long_names,
    of_source,
    repair_references,
    same,
    source_named,
    sticks_out,
    together,
)
from gateway.signals.ranges import narrowed, widened
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError, named, nearest

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

_log = get_logger(__name__)

_LINE = re.compile(r"line (\d+)")
#: Of files that hold a database.
SUFFIXES = (".dbc", ".kcd", ".sym", ".arxml")
#: Statements that a file may lose, since they are none of its format.
MOST_LEFT_OUT = 100


class Database:
    """The messages of one bus, from one or several files.

    Equal messages are one. Different ones of one name are known by their exact names (:mod:`gateway.signals.identity`).
    Of several with one identifier the first is decoded; the others are there for those who name them.
    """

    def __init__(self, messages: Sequence[tuple[Message, Path]]) -> None:
        self._files = dict.fromkeys(str(file) for _, file in messages)
        self._messages: dict[str, Message] = {}
        self._file_of: dict[str, Path] = {}
        self._joined: dict[str, Mapping[str, tuple[Signal, ...]]] = {}
        self._ambiguous: dict[str, list[str]] = {}
        self._shadowed: dict[str, str] = {}
        self._notes: list[str] = []
        self._sources: dict[str, Message] = {}
        of_name: dict[str, list[tuple[Message, Path]]] = {}
        for container, file in messages:
            for message in (container, *contained_in(container)):
                of_name.setdefault(message.name, []).append((message, file))
        for name, mine in of_name.items():
            different = _different(mine)
            if len(different) == 1:
                self._add(*different[0])
            else:
                self._add_all(name, different, of_name)
        self._shadow()

    def _add_all(self, name: str, messages: Sequence[tuple[Message, Path]], taken: Collection[str]) -> None:
        """Take different messages of one name."""
        for message, file in messages:
            own = copy(message)
            own.name = exact_name(message)
            if own.name in self._messages and message.bus_name:  # of several buses of a file
                own.name += f"_{message.bus_name}"
            while own.name in self._messages or own.name in taken:
                own.name += "_"
            self._ambiguous.setdefault(name, []).append(own.name)
            self._add(own, file)
        self._notes.append(f"several messages have the name {name}: {' and '.join(self._ambiguous[name])}")

    def _add(self, message: Message, file: Path) -> None:
        self._messages[message.name], joined = exact_signals(message)
        self._file_of[message.name] = file
        if joined:
            self._joined[message.name] = joined

    def _shadow(self) -> None:
        """Find the messages whose identifier another one has already."""
        owners: dict[tuple[int, bool, bool], Message] = {}
        for name, message in self._messages.items():
            key = message.frame_id, message.is_extended_frame, message.protocol == CONTAINED
            owner = owners.setdefault(key, message)
            if owner is not message:
                self._shadowed[name] = owner.name
                of = {one.bus_name for one in (owner, message)} - {None}
                hint = f", of the buses {' and '.join(sorted(map(str, of)))}: choose one" if len(of) > 1 else ""
                text = f"{owner.name} and {name} have the identifier 0x{message.frame_id:X}{hint}"
                self._notes.append(f"{text}: frames of it are decoded as {owner.name}")

    @property
    def notes(self) -> list[str]:
        """Lines for people: names and identifiers that it gives twice, signals that are in no frame."""
        found = list(self._notes)
        for message in self:
            if message.is_container:
                own = {each.name for each in contained_in(message)}
                out = [each.name for each in message.contained_messages or () if each.name not in own]
                if out:
                    found.append(f"{message.name}: PDUs without a number of 29 bits are not decoded: {', '.join(out)}")
            elif message.length > (LONGEST_WOVEN if message.protocol == "j1939" else LONGEST):
                found.append(f"{message.name} has {message.length} bytes: of a frame the first {LONGEST} are decoded")
            out = [signal.name for signal in message.signals if sticks_out(message, signal)]
            if out and not message.is_container:
                found.append(f"{message.name} has {message.length} bytes; beyond them: {', '.join(out)}")
        for name, joined in self._joined.items():
            if not joined or name in self._sources:
                continue
            each = "; ".join(f"{one} ({' or '.join(signal.name for signal in of)})" for one, of in joined.items())
            found.append(f"{name} has signals of one name in several branches: {each}")
        return found

    def has(self, name: str) -> bool:
        """Return whether a message or one of its sources has a name, or several have it."""
        return name in self._messages or name in self._ambiguous or self._source(name) is not None

    def __iter__(self) -> Iterator[Message]:
        return (message for name, message in self._messages.items() if name not in self._shadowed)

    def __len__(self) -> int:
        return len(self._messages) - len(self._shadowed)

    def message(self, name: str) -> Message:
        """Return a message by name.

        Raises:
            InputError: there is none, names close ones; or several have it, names what tells them apart.
        """
        found = self._messages.get(name) or self._source(name)
        if found is None and name in self._ambiguous:
            each = " or ".join(f"{one} (in {self._file_of[one]})" for one in self._ambiguous[name])
            raise InputError(f"several messages have this name: write {each}", value=name)
        if found is None:
            known = list(self._messages)
            where = ", ".join(self._files) or "a database: this bus has none"
            raise InputError(f"no message {name!r} in {where}{nearest(name, known)}")
        return found

    def _source(self, name: str) -> Message | None:
        """Return a message as one source sends it, by its exact name; None: there is none."""
        if name not in self._sources:
            base, can_id = source_named(name) or ("", 0)
            message = self._messages.get(base)
            if message is None or not message.is_extended_frame or group_of(message.frame_id) != group_of(can_id):
                return None
            self._sources[name] = of_source(message, can_id)
            self._file_of[name] = self._file_of[base]
            self._joined[name] = self._joined.get(base, {})
        return self._sources[name]

    def file_of(self, message: str) -> Path:
        """Return the file that a message came from.

        Raises:
            InputError: there is no such message.
        """
        return self._file_of[self.message(message).name]

    def joined(self, message: str) -> Mapping[str, tuple[Signal, ...]]:
        """Return the names that signals in several branches of a message share: name -> these signals."""
        return self._joined.get(message, {})

    def signals(self, message: str) -> dict[str, Signal]:
        """Return the signals of a message by name; several that share one are one."""
        signals, joined = self.message(message).signals, self.joined(message)
        of = {signal.name: name for name, each in joined.items() for signal in each}
        found: dict[str, Signal] = {}
        for signal in signals:
            found.setdefault(of.get(signal.name, signal.name), signal)
        return {name: together(name, joined[name]) if name in joined else signal for name, signal in found.items()}

    def signal(self, message: str, name: str) -> Signal:
        """Return a signal of a message by name, or by exact name; of several that share a name what they are together.

        Raises:
            InputError: there is none; names close ones.
        """
        shared = self.joined(message).get(name)
        if shared:
            return together(name, shared)
        found = self.message(message)
        for signal in found.signals:
            if signal.name == name:
                return signal
        known = [signal.name for signal in found.signals]
        raise InputError(f"no signal {name!r} in message {message!r}{nearest(name, known)}")


def _different(messages: Sequence[tuple[Message, Path]]) -> list[tuple[Message, Path]]:
    """Return messages without those that are equal to one before: of the same identifier, and saying the same."""
    if len(messages) == 1:
        return list(messages)
    found: list[tuple[Message, Path]] = []
    for message, file in messages:
        key = message.frame_id, message.is_extended_frame
        if not any((one.frame_id, one.is_extended_frame) == key and same(one, message) for one, _ in found):
            found.append((message, file))
    return found


def load_database(paths: Sequence[Path]) -> Database:
    """Load the database of a bus.

    Loading is not strict: databases of real vehicles hold signals that overlap or stick out of
    their message, and those are decoded as cantools does.

    Args:
        paths: DBC, KCD, SYM or ARXML files; their messages are joined. ``file#bus`` is one bus of a file that has
            several.

    Raises:
        InputError: a file that cannot be read or parsed (with the line where it is known), that
            holds no CAN messages, or what no network has (see :mod:`gateway.signals.bounds`); a bus that it has not.
    """
    messages: list[tuple[Message, Path]] = []
    for path in paths:
        file, bus = file_and_bus(path)
        found = _load(file)
        if bus:
            known = sorted({message.bus_name for message in found if message.bus_name})
            if bus not in known:
                raise InputError(named("the buses of this file are", bus, known), file=file, value=bus)
            found = [message for message in found if message.bus_name == bus]
        messages += [(message, file) for message in found]
    return Database(messages)


def file_and_bus(path: Path) -> tuple[Path, str]:
    """Return the file, and the bus of it that ``file#bus`` names; "": all that it has."""
    name, _, bus = path.name.rpartition("#")
    return (path.with_name(name), bus) if name.lower().endswith(SUFFIXES) else (path, "")


def _load(path: Path) -> list[Message]:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"a database is one of {', '.join(SUFFIXES)}", file=path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    return messages_of(data, suffix, lambda: _parsed(text_of(data), suffix, path))


def _parsed(text: str, suffix: str, path: Path) -> list[Message]:
    if not text.strip():
        raise InputError("the file is empty", file=path)
    refuse_lengths(text, suffix, path)
    try:
        found = _read(text, suffix)
    except Exception as error:  # the parsers let any exception of theirs through
        again = _mended(text, suffix, path)
        if again is None:
            said = " ".join(str(error).split()) or type(error).__name__
            line = _line_of(said, text)
            said = re.sub(r'DBC: "Invalid syntax at line \d+, column (\d+): "(.*)""', r"at column \1: \2", said)
            raise InputError(f"not a good {suffix} file: {said}", file=path, line=line) from error
        found = again
    if not found:
        raise InputError("the file holds no CAN messages", file=path)
    refuse_scalings([*found, *(each for one in found for each in contained_in(one))], path)
    return found


def _read(text: str, suffix: str) -> list[Message]:
    import cantools  # noqa: PLC0415 - not where no database is read: its parsers take a while to load

    from gateway.signals.compact import compact  # noqa: PLC0415 - with cantools

    text, wide = narrowed(text) if suffix == ".dbc" else (with_short_headers(text), {})
    loaded = cantools.database.load_string(text, database_format=suffix[1:], strict=False)
    messages = list(loaded.messages) if isinstance(loaded, cantools.database.can.Database) else []
    read = sum(len(message.signals) for message in messages)
    if suffix == ".dbc":
        if read < (said := signals_said(text)):  # a line without receivers takes the next one for these
            raise ValueError(f"{said} signals, of which {read} can be read")
        repair_references(messages, text)
    compact(messages)
    widened(messages, wide, long_names(text) if wide else {})
    return messages


def _line_of(said: str, text: str) -> int | None:
    """Return the line that an error means: it says which, or names a message or a path that is there."""
    found = _LINE.search(said)
    if found:
        return int(found[1])
    words = {part for word in re.findall(r"[\w/.-]{3,}", said) for part in word.split("/")}
    named = sorted((word for word in words if re.search(r"[_\d]", word)), key=len)
    places = [text.find(word) for word in reversed(named)]
    at = next((place for place in places if place >= 0), None)
    return None if at is None else text.count("\n", 0, at) + 1


def _mended(text: str, suffix: str, path: Path) -> list[Message] | None:
    """Read a file that departs from its format in ways that are known, and say so; None: in others."""
    text, said = mended(text, suffix)
    for _ in range(MOST_LEFT_OUT):
        try:
            found = _read(text, suffix)
        except Exception as error:  # the first error is the one to tell
            line = _LINE.search(str(error))
            less = without(text, int(line[1])) if line and suffix == ".dbc" else None
            if less is None:
                return None
            text = less[0]
            said.append(f"a statement {less[1]} that is none of DBC left out")
            continue
        if said and found:
            counted = [f"{what} ({count})" if count > 1 else what for what, count in Counter(said).items()]
            _log.warning(f"this database departs from {suffix[1:].upper()}; put right", file=str(path), what=counted)
        return found or None
    return None
