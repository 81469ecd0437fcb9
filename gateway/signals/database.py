"""CAN databases: DBC, KCD, SYM and ARXML files through cantools, with errors a user can mend."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.signals.bounds import refuse_lengths, refuse_scalings
from gateway.signals.dialect import mended
from gateway.signals.parsed import messages_of
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError, nearest

if TYPE_CHECKING:
    from cantools.database.can import Database as CanDatabase
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

_log = get_logger(__name__)

_LINE = re.compile(r"line (\d+)")
#: Of files that hold a database.
SUFFIXES = (".dbc", ".kcd", ".sym", ".arxml")


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
        refuse_scalings(found, path)
        messages += [(message, path) for message in found]
    return Database(messages)


def _load(path: Path) -> list[Message]:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"a database is one of {', '.join(SUFFIXES)}", file=path)
    try:
        data = path.read_bytes()
        refuse_lengths(data.decode("utf-8", "replace"), suffix, path)
        return messages_of(data, suffix, lambda: _parsed(path, suffix))
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error


def _parsed(path: Path, suffix: str) -> list[Message]:
    import cantools  # noqa: PLC0415 - not where no database is read: its parsers take a while to load

    try:
        loaded = cantools.database.load_file(path, strict=False, database_format=suffix[1:])
    except OSError:
        raise
    except Exception as error:  # the parsers let any exception of theirs through
        again = _mended(path, suffix)
        if again is not None:
            return list(again.messages)
        text = " ".join(str(error).split()) or type(error).__name__
        found = _LINE.search(text)
        line = int(found[1]) if found else None
        raise InputError(f"not a good {suffix} file: {text}", file=path, line=line) from error
    if not isinstance(loaded, cantools.database.can.Database) or not loaded.messages:
        raise InputError("the file holds no CAN messages", file=path)
    return list(loaded.messages)


def _mended(path: Path, suffix: str) -> CanDatabase | None:
    """Read a DBC file that departs from the format in ways that are known, and say so; None: in others."""
    import cantools  # noqa: PLC0415

    if suffix != ".dbc":
        return None
    text, said = mended(path.read_bytes().decode("cp1252", "replace"))
    if not said:
        return None
    try:
        loaded = cantools.database.load_string(text, database_format="dbc", strict=False)
    except Exception:  # the first error is the one to tell
        return None
    if not isinstance(loaded, cantools.database.can.Database) or not loaded.messages:
        return None
    _log.warning("this database departs from DBC; put right", file=str(path), what=said)
    return loaded
