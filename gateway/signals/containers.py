"""Containers of AUTOSAR (IpduM): PDUs, each behind a header of its own, in one frame.

A header has the number of the PDU and its length: 24 and 8 bits (short), or 32 and 32 (long). A number of 0 ends a
container; what follows is padding. cantools reads containers of short headers: long numbers are given to it as short
ones, marked.
"""

from __future__ import annotations

import re
from copy import copy
from typing import TYPE_CHECKING, Literal, NamedTuple

from gateway.bus.frames import ID_MASK

if TYPE_CHECKING:
    from cantools.database.can import Message

#: Protocol of a PDU of a container; its identifier is the number in its header.
CONTAINED = "contained"
#: Added to the number of a PDU that stands in a long header.
LONG = 1 << 40
_LONG_TYPE = re.compile(r"(<HEADER-TYPE>\s*)LONG-HEADER(\s*</HEADER-TYPE>)")
_LONG_ID = re.compile(r"<HEADER-ID-LONG-HEADER>\s*(\w+)\s*</HEADER-ID-LONG-HEADER>")
_SHORT_ID = "<HEADER-ID-SHORT-HEADER>"


def with_short_headers(text: str) -> str:
    """Return an ARXML file whose containers all have short headers, for cantools; one of both kinds as it is."""
    if not _LONG_TYPE.search(text) or _SHORT_ID in text:
        return text
    marked = _LONG_ID.sub(lambda found: f"{_SHORT_ID}{int(found[1], 0) + LONG}</{_SHORT_ID[1:]}", text)
    return _LONG_TYPE.sub(r"\1SHORT-HEADER\2", marked)


def contained_in(message: Message) -> list[Message]:
    """Return the PDUs of a container as messages of their own; none of those whose number has more than 29 bits."""
    made = []
    for each in message.contained_messages or ():
        number = (each.header_id or 0) & ~LONG
        if 0 < number <= ID_MASK:
            own = copy(each)
            own._frame_id, own._protocol, own._bus_name = number, CONTAINED, message.bus_name
            made.append(own)
    return made


class Container(NamedTuple):
    """Layout of a container.

    Attributes:
        number: bytes of a PDU's number in its header.
        length: bytes of its length.
        big: whether the most significant byte comes first.
        known: numbers of the PDUs that the database has.
    """

    number: int
    length: int
    big: bool
    known: frozenset[int]


def container_of(message: Message) -> Container:
    """Return the layout of a container."""
    numbers = [each.header_id or 0 for each in message.contained_messages or ()]
    long = any(number & LONG for number in numbers)
    known = frozenset(number & ~LONG for number in numbers)
    return Container(4 if long else 3, 4 if long else 1, message.header_byte_order == "big_endian", known)


def unpack(data: bytes, of: Container) -> tuple[list[tuple[int, bytes]], bool]:
    """Return the PDUs in the data of a container, number and payload of each, and whether all of it could be read."""
    order: Literal["big", "little"] = "big" if of.big else "little"
    found, at, head = list[tuple[int, bytes]](), 0, of.number + of.length
    while at + head <= len(data):
        number = int.from_bytes(data[at : at + of.number], order)
        length = int.from_bytes(data[at + of.number : at + head], order)
        if not number:
            return found, True
        at += head + length
        if at > len(data):
            return found, False
        found.append((number, data[at - length : at]))
    return found, not any(data[at:])
