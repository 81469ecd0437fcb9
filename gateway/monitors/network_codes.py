"""DTCs given out automatically: network codes of signals, relations and checked messages, stable over edits of others.

A code is made of a digest of its name; only where two names make the same one, the later of them by the alphabet takes
the next that is free. Codes that the configuration gives itself, or that a monitor has, are never given out.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

from gateway_fdi.errors import InputError

#: U1000 to U2FFF are the manufacturer's (SAE J2012, 5.1).
_FIRST, _CODES = 0x1000, 0x2000
#: U0100 to U02FF are of lost communication, U0400 to U05FF of invalid data received (SAE J2012-DA).
_LOST, _INVALID, _SLOTS = 0x0100, 0x0400, 0x200

#: A code of the network; one that is none is refused where its fault is.
_NETWORK = re.compile("U[0-3][0-9A-Fa-f]{3}")


class Pair(NamedTuple):
    """Base codes of a message's faults: it does not come, or it is wrong."""

    lost: str
    invalid: str


def _text(code: int) -> str:
    return f"U{code:04X}"


def _placed(names: Iterable[str], size: int, used: Collection[int]) -> dict[str, int]:
    """Return a place below ``size`` for each name; names for which there is no room are left out.

    Args:
        names: in any order.
        size: how many places there are.
        used: places that are not given out.
    """
    taken, found = set(used), {}
    for name in sorted(set(names)):
        if len(taken) == size:
            break
        at = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=4).digest(), "big") % size
        while at in taken:
            at = (at + 1) % size
        taken.add(at)
        found[name] = at
    return found


class NetworkCodes:
    """The codes of one configuration.

    Args:
        taken: base codes, or whole DTCs, that are in use.

    Attributes:
        given: full name of a signal, a relation or a message -> the base codes given out for it.
    """

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = {int(code[1:5], 16) for code in taken if _NETWORK.match(code)}
        self.given: dict[str, tuple[str, ...]] = {}

    def give(self, bus: str, names: Iterable[str]) -> dict[str, str]:
        """Return a manufacturer's base code for each name, ``U1xxx`` or ``U2xxx``; the same name has the same one.

        Args:
            bus: its name.
            names: of signals with their messages, or of relations; unique on the bus.

        Raises:
            InputError: there are none left.
        """
        asked = {f"{bus}.{name}": name for name in names}
        new = [full for full in asked if full not in self.given]
        places = _placed(new, _CODES, self._manufacturers())
        for full in new:
            if full not in places:
                raise InputError(f"all {_CODES} codes from U1000 to U2FFF are in use: give code", value=asked[full])
            self._take(full, _text(_FIRST + places[full]))
        return {name: self.given[full][0] for full, name in asked.items()}

    def pairs(self, messages: Iterable[str], asked: Collection[str]) -> Mapping[str, Pair]:
        """Return base codes of messages.

        Each of *all* messages has a place of its own, whether it is checked or not, so that no check has an influence
        on another's codes: ``U0100 + h`` and ``U0400 + h``. One whose place has a code in use gets the next free one;
        when there is none, a manufacturer's code, for both.

        Args:
            messages: all that the databases of the buses have, with their bus.
            asked: those of them that are to have codes.

        Raises:
            InputError: there are none left.
        """
        places = _placed(messages, _SLOTS, ())
        barred = {code - first for first in (_LOST, _INVALID) for code in self._taken if 0 <= code - first < _SLOTS}
        moved = [name for name, place in places.items() if place in barred]
        kept = {name: place for name, place in places.items() if place not in barred}
        placed = kept | _placed(moved, _SLOTS, barred | set(kept.values()))
        beyond = _placed(set(messages) - set(placed), _CODES, self._manufacturers())
        found = {name: Pair(_text(_LOST + h), _text(_INVALID + h)) for name, h in placed.items() if name in asked}
        found |= {name: Pair(*[_text(_FIRST + at)] * 2) for name, at in beyond.items() if name in asked}
        for name in sorted(asked):
            if name not in found:
                raise InputError("all network codes are in use: give lost and invalid", value=name)
            self._take(name, *dict.fromkeys(found[name]))
        return found

    def _manufacturers(self) -> set[int]:
        """Return the places of manufacturer's codes that are in use."""
        return {code - _FIRST for code in self._taken if 0 <= code - _FIRST < _CODES}

    def _take(self, name: str, *codes: str) -> None:
        self.given[name] = codes
        self._taken |= {int(code[1:], 16) for code in codes}
