"""Unknown identifiers of a bus: neither its databases, servers and testers nor the ECUs that are asked have them.

Each is counted, with its first payload. It is told at its first, tenth, hundredth frame and so on, so that a flood is a
bounded number of events.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED
from gateway.j1939.frame import TP_CM, TP_DT
from gateway.signals.database import Database
from gateway.signals.decode import exact_key, pgn_key
from gateway.signals.keys import by_pgn, can_id_of, hash_table, is_woven
from gateway_fdi.jit import Record, i8, means, u1, u4, u8

#: Unknown identifiers that have a place of their own; further ones share the last place.
MOST = 64


class UnknownId(Record):
    """One unknown identifier of one bus."""

    bus: u1 = means("number of the bus")
    length: u1 = means("of its first frame", "byte")
    elsewhere: u1 = means("number of another bus that knows it, and one; 0: none does")
    can_id: u4 = means("identifier, with EXTENDED")
    count: i8 = means("frames since the start")
    woke: u1 = means("whether it came while the bus woke")
    tell: i8 = means("count at which it is told next")
    first_ns: i8 = means("its first frame", "ns")
    word: u8 = means("first 8 bytes of its first payload")


def known_table(
    databases: Sequence[tuple[int, Database]],
    known: Sequence[tuple[int, Collection[int], Collection[int]]],
    pgn: Collection[int],
) -> tuple[NDArray[np.uint64], NDArray[np.int32]]:
    """Return the table of what each bus knows, for ``lookup``.

    Args:
        databases: (bus index, database) pairs; all their messages are known, wanted or not.
        known: bus index, identifiers (with EXTENDED), and identifiers whose whole parameter group is known.
        pgn: buses whose extended identifiers all match by PGN.
    """
    keys: set[Any] = set()
    for bus, database in databases:
        for message in database:
            can_id = can_id_of(message)
            keys.add(pgn_key(bus, can_id) if by_pgn(message, bus in pgn) else exact_key(bus, can_id))
            if is_woven(message, bus in pgn):
                keys.update(pgn_key(bus, EXTENDED | carrier << 8) for carrier in (TP_CM, TP_DT))
    for bus, identifiers, groups in known:
        for can_id in identifiers:
            keys.add(pgn_key(bus, can_id) if can_id & EXTENDED and bus in pgn else exact_key(bus, can_id))
        keys.update(pgn_key(bus, can_id) for can_id in groups)
    return hash_table(sorted(int(key) for key in keys))
