"""Evidence for people: names with units, and numbers that stand for names.

A value of the evidence is a number. One that stands for names says so in its own name: a set as bits, a ranking as
digits. People read the names; programs have the number, and the name that tells what it stands for.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

_FORM = re.compile(r"(.+?) \[(bits|[123] digits each)(?:: (.*))?\]", re.DOTALL)
_BITS = "bits"


def as_bits(label: str, names: Sequence[str]) -> str:
    """Return the name of evidence that is a set: bit k is there if the name k is one of it."""
    return f"{label} [{_BITS}: {'; '.join(names)}]"


def as_digits(label: str, names: Sequence[str], each: int) -> str:
    """Return the name of evidence that is a ranking: this number of digits for each place, 1 is the first name.

    Without names the places are told by their numbers.
    """
    return f"{label} [{each} digits each{': ' if names else ''}{'; '.join(names)}]"


def stands_for_names(name: str) -> bool:
    """Return whether a value of the evidence stands for names: of :func:`as_bits` or :func:`as_digits`."""
    return _FORM.fullmatch(name) is not None


def in_words(name: str, value: float | None, number: str) -> tuple[str, str]:
    """Return what a value of the evidence is, and the value with its unit, for people.

    Args:
        name: of the value, with its unit in brackets at the end; or of :func:`as_bits`, :func:`as_digits`.
        value: None: unknown.
        number: the value as a number for people.
    """
    form = _FORM.fullmatch(name)
    if form is None:
        label, _, unit = name.partition(" [")
        return label, f"{number} {unit.removesuffix(']')}".strip() if value is not None else number
    label, kind, names = form[1], form[2], (form[3] or "").split("; ")
    if value is None:
        return label, number
    places = _bits(int(value)) if kind == _BITS else _digits(int(value), int(kind[0]))
    told = [names[k] if form[3] and k < len(names) else f"number {k + 1}" for k in places]
    return label, ", ".join(told) or "none"


def _bits(value: int) -> list[int]:
    return [k for k in range(value.bit_length()) if value >> k & 1]


def _digits(value: int, each: int) -> list[int]:
    places = []
    while value > 0:
        value, place = divmod(value, 10**each)
        places.append(place - 1)
    return places[::-1]


def words_of(name: str) -> str:
    """Return a name of the configuration for people: words instead of parts joined by ``_``."""
    return name.replace("_", " ")
