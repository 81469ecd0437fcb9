"""Bounds of databases: no real network is beyond them; nonsense, or gigabytes, are refused with the place."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message

#: Bytes of a message at most: of those that transport protocols carry, J1939's have 1785, ISO-TP's mostly 4095.
LONGEST = 1 << 16

#: Suffix -> where a text has lengths of messages [byte], or places and lengths of signals [bit].
_LENGTHS = {
    ".dbc": (
        r"^[ \t]*BO_[ \t]+\d+[ \t]+(?P<name>\w+)[ \t]*:[ \t]*(?P<byte>\d+)",
        r"^[ \t]*SG_[ \t]+(?P<name>\w+)[^:\n]*:[ \t]*(?P<bit>\d+)[ \t]*\|[ \t]*(?P<other>\d+)",
    ),
    ".kcd": (
        r"""<Message\b[^>]*?\blength\s*=\s*["'](?P<byte>\d+)""",
        r"""<(?:Signal|Multiplex)\b[^>]*?\boffset\s*=\s*["'](?P<bit>\d+)""",
        r"""<(?:Signal|Multiplex)\b[^>]*?\blength\s*=\s*["'](?P<bit>\d+)""",
    ),
    ".sym": (
        r"^[ \t]*(?:Len|DLC)[ \t]*=[ \t]*(?P<byte>\d+)",
        r"^[ \t]*(?:Var|Mux)[ \t]*=[^\n]*?(?P<bit>\d+),(?P<other>\d+)",
    ),
    ".arxml": (r"<FRAME-LENGTH>\s*(?P<byte>\d+)", r"<(?:START-POSITION|LENGTH)>\s*(?P<bit>\d+)"),
}


def refuse_lengths(text: str, suffix: str, file: Path) -> None:
    """Refuse a message or a signal that is longer than any: the parser would fill the memory with it.

    Raises:
        InputError: names line and length.
    """
    for pattern in _LENGTHS.get(suffix, ()):
        most, what = LONGEST, f"a message has at most {LONGEST} bytes"
        if "<bit>" in pattern:
            most, what = LONGEST * 8, f"a signal lies within {LONGEST * 8} bits"
        for found in re.finditer(pattern, text, re.MULTILINE):
            groups = found.groupdict()
            name = groups.pop("name", None)
            for number in filter(None, groups.values()):
                if len(number.lstrip("0")) > len(str(most)) or int(number) > most:
                    line = text.count("\n", 0, found.start("bit" if "<bit>" in pattern else "byte")) + 1
                    value = number if len(number) > 15 else int(number)
                    raise InputError(what, file=file, line=line, key=name, value=value)


def refuse_scalings(messages: Iterable[Message], file: Path) -> None:
    """Refuse signals whose values would all be the same, or none at all.

    Raises:
        InputError: a factor is 0 or infinite, or an offset is infinite; names message and signal.
    """
    for message in messages:
        for signal in message.signals:
            factor, offset = _number(signal.scale), _number(signal.offset)
            key = f"{message.name}.{signal.name}"
            if factor == 0 or not math.isfinite(factor):
                raise InputError("a factor is a number other than 0", file=file, key=f"{key}.factor", value=factor)
            if not math.isfinite(offset):
                raise InputError("an offset is a number", file=file, key=f"{key}.offset", value=offset)


def _number(value: float) -> float:
    """Return a number as the engine has it; one of thousands of digits is infinite there."""
    try:
        return float(value)
    except OverflowError:
        return math.inf
