"""Layouts of the answers to diagnostic requests: which bits of an answer are which signal.

An answer to a request ``22 F1 90`` is ``62 F1 90`` and data. Its layout is a message of a database, whose bits count from
the first byte after the identifier, so that all that is done with signals of frames is done with those of answers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from gateway.signals.database import SUFFIXES, load_database
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message

_log = get_logger(__name__)

#: Services whose identifier has two bytes; those of others have one.
TWO_BYTES = (0x22, 0x2A, 0x2E, 0x2F, 0x31)


@dataclass(frozen=True)
class Address:
    """Address of an ECU on ISO-TP.

    Attributes:
        request: identifier of requests, with EXTENDED if it has 29 bits.
        response: identifier of its answers; None: the file does not say.
        extended: address byte before the transport's own in requests (extended addressing); None: there is none.
        tester: the same in answers.
    """

    request: int
    response: int | None = None
    extended: int | None = None
    tester: int | None = None


class Limits(NamedTuple):
    """Physical values of a signal that a file calls no values, or unlikely; None: it does not say.

    Attributes:
        void_low: at most this: the signal carries no value.
        void_high: at least this: the signal carries no value.
        low: below this the value is unlikely.
        high: above this the value is unlikely.
    """

    void_low: float | None = None
    void_high: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class AnswerLayout:
    """Layout of the answers to one request.

    Attributes:
        service: of the request: 0x22, 0x01, 0x21, 0x09 ...
        identifier: DID (0..0xFFFF) or PID (0..0xFF).
        message: extended, its identifier ``service << 16 | identifier``; bits count from the first byte after the
            identifier; its length is what its signals need [byte], and may be more than 64.
        address: ECU that answers so; None: any.
        limits: by the names of signals.
        every_s: how often the file asks for it [s]; None: it does not say.
    """

    service: int
    identifier: int
    message: Message
    address: Address | None = None
    limits: Mapping[str, Limits] = field(default_factory=dict)
    every_s: float | None = None

    @property
    def name(self) -> str:
        """Return the request as hexadecimal digits, as people write it: 22F190, 010C."""
        return request_name(self.service, self.identifier)


def request_name(service: int, identifier: int) -> str:
    """Return a request as hexadecimal digits: 22F190, 010C."""
    return f"{service:02X}{identifier:0{4 if service in TWO_BYTES else 2}X}"


class LeftOut(NamedTuple):
    """A part of a file that has no layout.

    Attributes:
        where: in the file: request, signal.
        why: in words.
    """

    where: str
    why: str


class Layouts(NamedTuple):
    """Contents of a file of layouts.

    Attributes:
        layouts: in the file's order.
        left_out: what has none.
    """

    layouts: tuple[AnswerLayout, ...]
    left_out: tuple[LeftOut, ...] = ()


def message_of(service: int, identifier: int, signals: Sequence[Any], *, name: str = "", comment: str = "") -> Message:
    """Return the message of a layout.

    Args:
        service: of the request.
        identifier: DID or PID.
        signals: of cantools, shape (signals,); bits count from the first byte after the identifier.
        name: of the message; "": the request's.
        comment: for people.
    """
    from cantools.database.can import Message  # noqa: PLC0415 - takes a while to load

    ends = [_end(signal) for signal in signals]
    return Message(
        frame_id=service << 16 | identifier,
        name=name or f"A_{request_name(service, identifier)}",
        length=-(-max(ends, default=0) // 8),
        signals=list(signals),
        comment=comment or None,
        is_extended_frame=True,
        strict=False,
    )


def _end(signal: Any) -> int:
    """Return how many bits of a payload a signal needs."""
    start = int(signal.start)
    if signal.byte_order == "big_endian":
        start = 8 * (start // 8) + 7 - start % 8
    return start + int(signal.length)


def of_messages(messages: Iterable[Message], file: Path) -> Layouts:
    """Return the layouts of a database whose identifiers are ``service << 16 | identifier``, extended.

    Raises:
        InputError: none is.
    """
    found, left = [], []
    for message in messages:
        service, identifier = message.frame_id >> 16, message.frame_id & 0xFFFF
        if not message.is_extended_frame or not 0 < service < 0x40:
            left.append(LeftOut(message.name, f"0x{message.frame_id:X} is no extended service << 16 | identifier"))
        elif service not in TWO_BYTES and identifier > 0xFF:
            left.append(LeftOut(message.name, f"service 0x{service:02X} has identifiers up to 0xFF"))
        else:
            found.append(AnswerLayout(service, identifier, message))
    if not found:
        raise InputError("no message has an extended identifier service << 16 | identifier, as 0x22F190", file=file)
    return Layouts(tuple(found), tuple(left))


def _of_database(path: Path, _year: int | None) -> Layouts:
    return of_messages(load_database([path]), path)


#: Suffix -> reader: of the file and a model year.
_READERS: dict[str, Callable[[Path, int | None], Layouts]] = dict.fromkeys(SUFFIXES, _of_database)


def read_file(path: Path, year: int | None = None) -> Layouts:
    """Read the layouts of a file, and what it has besides.

    Args:
        path: of a database (DBC, KCD, SYM, ARXML: an extended identifier ``service << 16 | identifier`` a message).
        year: model year, where a file distinguishes them; None: all, of two for one request the later.

    Raises:
        InputError: it cannot be read, or has no layouts; names file, line or key.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"layouts of answers are in files {', '.join(sorted(_READERS))}", file=path)
    return reader(path, year)


def read_layouts(path: Path, year: int | None = None) -> tuple[AnswerLayout, ...]:
    """Read the layouts of a file; a line of the log says how many of its parts have none.

    Args:
        path: as of :func:`read_file`.
        year: as there.

    Raises:
        InputError: as there.
    """
    found = read_file(path, year)
    if found.left_out:
        _log.warning("parts of the file have no layout", file=str(path), parts=len(found.left_out), first=found.left_out[0])
    return found.layouts


def layouts_for(layouts: Iterable[AnswerLayout], address: Address) -> dict[tuple[int, int], AnswerLayout]:
    """Return the layouts of one ECU's answers, by service and identifier; its own win over those of any ECU."""
    chosen: dict[tuple[int, int], AnswerLayout] = {}
    for layout in sorted(layouts, key=lambda each: each.address is not None):
        own = layout.address
        if own is None or (own.request, own.extended) == (address.request, address.extended):
            chosen[layout.service, layout.identifier] = layout
    return chosen
