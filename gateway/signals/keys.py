"""By which identifiers frames find their message: exact ones, groups of J1939, messages that are woven, PDUs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, WOVEN
from gateway.j1939.frame import group_of
from gateway.j1939.overheard import FAST
from gateway.signals.bits import LONGEST
from gateway.signals.containers import CONTAINED, Container, container_of
from gateway.signals.database import Database
from gateway.signals.decode import exact_key, hashed, pgn_key, source_key
from gateway.signals.identity import ONE_SOURCE, needs
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message

#: J1939 source address of a database's message that any node may send: the null address.
ANY_SOURCE = 0xFE


def by_pgn(message: Message, whole_bus: bool) -> bool:
    """Return whether a message matches by its PGN, ``whole_bus``: all of its bus do."""
    return message.is_extended_frame and message.protocol != ONE_SOURCE and (whole_bus or message.protocol == "j1939")


def is_woven(message: Message, whole_bus: bool) -> bool:
    """Return whether a message may come in several frames, of J1939 or NMEA 2000; ``whole_bus`` as above."""
    return message.length > 8 and (message.protocol == ONE_SOURCE or by_pgn(message, whole_bus))


def is_alone(message: Message, woven: bool) -> bool:
    """Return whether a message is decoded of frames as they are on the bus; ``woven``: it may come in several, too.

    A group of J1939 that fits comes as one frame: it may be shorter than its message, or of CAN FD. A frame of a fast
    packet is no message by itself.
    """
    longest = max([message.length, *map(needs, message.signals)])
    return not woven or (group_of(message.frame_id) < FAST and longest <= LONGEST)


def _identifiers(message: Message, woven: bool) -> list[int]:
    """Return the identifiers of the frames that a message is decoded of."""
    can_id = can_id_of(message)
    return [can_id] * is_alone(message, woven) + [can_id | WOVEN] * woven


def key_table(
    messages: Sequence[tuple[int, Message]], by_group: Sequence[bool], woven: Sequence[bool]
) -> tuple[NDArray[np.uint64], NDArray[np.int32]]:
    """Return the table of all keys by which frames find their message.

    Raises:
        InputError: two messages have one identifier.
    """
    made: dict[int, int] = {}
    # As plain Python: for a number by itself the way to machine code is longer.
    of_id, of_group, of_source = (getattr(each, "py_func", each) for each in (exact_key, pgn_key, source_key))
    each = [(row, bus, _identifiers(message, woven[row])) for row, (bus, message) in enumerate(messages)]
    for row, bus, identifiers in each:
        for can_id in identifiers:
            other = made.setdefault(int(of_id(bus, can_id)), row)
            if other != row:
                message = messages[row][1]
                text = f"has the identifier of {messages[other][1].name}: 0x{message.frame_id:X}"
                raise InputError(text, key=message.name)
    for row, bus, identifiers in each:
        if messages[row][1].protocol == ONE_SOURCE:
            for can_id in identifiers:
                made.setdefault(int(of_source(bus, can_id)), row)
    # Of several messages of a group that of any source takes the frames of sources that none names.
    groups = [row for row, group in enumerate(by_group) if group]
    for row in sorted(groups, key=lambda row: (messages[row][1].frame_id & 0xFF != ANY_SOURCE, row)):
        _, bus, identifiers = each[row]
        for can_id in identifiers:
            if can_id & 0xFF != ANY_SOURCE:
                made.setdefault(int(of_source(bus, can_id)), row)
            made.setdefault(int(of_group(bus, can_id)), row)
    return hash_table(list(made), list(made.values()))


def can_id_of(message: Message) -> int:
    """Return the identifier of a message as frames have it, with its flag EXTENDED, or WOVEN of one in a container."""
    flags = EXTENDED if message.is_extended_frame else WOVEN if message.protocol == CONTAINED else 0
    return int(message.frame_id) | flags


def hash_table(keys: Sequence[int], of: Sequence[int] | None = None) -> tuple[NDArray[np.uint64], NDArray[np.int32]]:
    """Return the open-addressed table of different keys, for ``find``; ``of``: the row of each, None: its place."""
    capacity = 8
    while capacity < 2 * len(keys) + 1:
        capacity *= 2
    slots, rows = np.zeros(capacity, np.uint64), np.full(capacity, -1, np.int32)
    begins = getattr(hashed, "py_func", hashed)
    for row, key in zip(range(len(keys)) if of is None else of, keys, strict=True):
        at = int(begins(np.uint64(key), capacity - 1))
        while rows[at] >= 0:
            at = (at + 1) % capacity
        slots[at], rows[at] = key, row
    return slots, rows


def containers_of(
    databases: Sequence[tuple[int, Database]], chosen: Sequence[tuple[int, Message]]
) -> dict[tuple[int, int], Container]:
    """Return the containers that have a PDU which is chosen."""
    wanted = {(bus, message.frame_id) for bus, message in chosen if message.protocol == CONTAINED}
    found = {
        (bus, can_id_of(message)): container_of(message)
        for bus, database in databases
        for message in (database if wanted else ())
        if message.is_container
    }
    return {place: each for place, each in found.items() if any((place[0], one) in wanted for one in each.known)}
