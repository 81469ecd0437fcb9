"""DTCs given out automatically: a manufacturer's network code for each signal, stable over edits of the others."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

#: U1000 to U2FFF are the manufacturer's (SAE J2012, 5.1).
_FIRST, _CODES = 0x1000, 0x2000


def network_codes(names: Iterable[str], taken: Iterable[str]) -> dict[str, str]:
    """Return a base code for each name, ``U1xxx`` or ``U2xxx``.

    A code is made of its name; only where two names make the same one the later of them, in the order of the alphabet,
    takes the next that is free.

    Args:
        names: of signals, with bus and message.
        taken: base codes that are in use.
    """
    used = {int(code[1:], 16) for code in taken if code.startswith("U")}
    found = {}
    for name in sorted(set(names)):
        at = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=4).digest(), "big") % _CODES
        while _FIRST + at in used:
            at = (at + 1) % _CODES
        used.add(_FIRST + at)
        found[name] = f"U{_FIRST + at:04X}"
    return found
