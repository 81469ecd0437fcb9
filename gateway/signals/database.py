"""CAN databases: DBC, KCD, SYM and ARXML files through cantools, with errors a user can mend."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.signals.bounds import refuse_lengths, refuse_scalings
from gateway.signals.dialect import mended, signals_said, text_of, without
from gateway.signals.parsed import messages_of
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError, nearest

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

    Messages that share a name (some SYM files have them) are left out; asking for one is an error.

    Args:
        messages: (message, file it came from) pairs.
    """

    def __init__(self, messages: Sequence[tuple[Message, Path]]) -> None:
        self._files = dict.fromkeys(str(file) for _, file in messages)
        self._file_of = {message.name: file for message, file in messages}
        count = Counter(message.name for message, _ in messages)
        self._messages = {m.name: m for m, _ in messages if count[m.name] == 1}
        self._ambiguous = {
            name: sorted({str(file) for m, file in messages if m.name == name})
            for name, number in count.items()
            if number > 1
        }

    def __iter__(self) -> Iterator[Message]:
        return iter(self._messages.values())

    def __len__(self) -> int:
        return len(self._messages)

    def message(self, name: str) -> Message:
        """Return a message by name.

        Raises:
            InputError: there is none; names close ones.
        """
        found = self._messages.get(name)
        if name in self._ambiguous:
            files = " and ".join(self._ambiguous[name])
            raise InputError(f"several messages have this name, in {files}", value=name)
        if found is None:
            known = list(self._messages)
            where = ", ".join(self._files) or "a database: this bus has none"
            raise InputError(f"no message {name!r} in {where}{nearest(name, known)}")
        return found

    def file_of(self, message: str) -> Path:
        """Return the file that a message came from.

        Raises:
            InputError: there is no such message.
        """
        return self._file_of[self.message(message).name]

    def signal(self, message: str, name: str) -> Signal:
        """Return a signal of a message by name.

        Raises:
            InputError: there is none; names close ones.
        """
        found = self.message(message)
        for signal in found.signals:
            if signal.name == name:
                return signal
        known = [signal.name for signal in found.signals]
        raise InputError(f"no signal {name!r} in message {message!r}{nearest(name, known)}")


def load_database(paths: Sequence[Path]) -> Database:
    """Load the database of a bus.

    Loading is not strict: databases of real vehicles hold signals that overlap or stick out of
    their message, and those are decoded as cantools does.

    Args:
        paths: DBC, KCD, SYM or ARXML files; their messages are joined.

    Raises:
        InputError: a file that cannot be read or parsed (with the line where it is known), that
            holds no CAN messages, or what no network has (see :mod:`gateway.signals.bounds`).
    """
    messages: list[tuple[Message, Path]] = []
    for path in paths:
        found = _load(path)
        messages += [(message, path) for message in found]
    return Database(messages)


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
    refuse_lengths(text, suffix, path)
    try:
        found = _read(text, suffix)
    except Exception as error:  # the parsers let any exception of theirs through
        again = _mended(text, suffix, path)
        if again is None:
            said = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"not a good {suffix} file: {said}", file=path, line=_line_of(said, text)) from error
        found = again
    if not found:
        raise InputError("the file holds no CAN messages", file=path)
    refuse_scalings(found, path)
    return found


def _read(text: str, suffix: str) -> list[Message]:
    import cantools  # noqa: PLC0415 - not where no database is read: its parsers take a while to load

    from gateway.signals.compact import compact  # noqa: PLC0415 - with cantools

    loaded = cantools.database.load_string(text, database_format=suffix[1:], strict=False)
    messages = list(loaded.messages) if isinstance(loaded, cantools.database.can.Database) else []
    read = sum(len(message.signals) for message in messages)
    if suffix == ".dbc" and read < (
        said := signals_said(text)
    ):  # a line without receivers takes the next one for these
        raise ValueError(f"{said} signals, of which {read} can be read")
    compact(messages)
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
