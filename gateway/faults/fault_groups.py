"""Entries by what explains them: a case is a cause with the entries that it explains, folded below it.

One order for all lists of faults: faults that fail now first, of these the proven ones, then the latest failure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from gateway.faults.explanation import CAUSE, OPEN
from gateway.faults.status import Status

#: Components, and DTCs of one kind, that are named one by one; of more some are, and the rest is counted.
MOST_NAMED = 3


class Case(NamedTuple):
    """A cause and the entries that it explains.

    Attributes:
        components: of the cause that is proven, or of the likeliest one; none: nothing is known to explain the entry.
        probability: of it; 0: nothing is known.
        proven: whether it is certain.
        ranked: all causes that are known, likeliest first, in the form of the JSON contract.
        failing: how many of the entries fail now.
        entries: in the form of the JSON contract; the one that stands for the cause first, then as they failed last.
    """

    components: tuple[str, ...]
    probability: float
    proven: bool
    ranked: Sequence[Mapping[str, Any]]
    failing: int
    entries: Sequence[Mapping[str, Any]]

    @property
    def text(self) -> str:
        """Its text for people, in one line; "": nothing is known to explain it."""
        if not self.probability:
            return ""
        if self.proven:
            return f"{briefly_named(self.components)} ({percent(self.probability)})"
        told = [f"{briefly_named(one['components'])} {percent(one['probability'])}" for one in self.ranked]
        return "not isolated: " + ", ".join(told)

    @property
    def symptoms(self) -> Sequence[Mapping[str, Any]]:
        """The entries that are folded below the first."""
        return self.entries[1:]

    def as_dict(self) -> dict[str, Any]:
        """Return it in the form of the JSON contract; its entries by the ids of their faults."""
        return {
            "components": list(self.components),
            "probability": self.probability,
            "proven": self.proven,
            "text": self.text,
            "failing": self.failing,
            "faults": [entry["fault"] for entry in self.entries],
        }


def named(components: Sequence[str]) -> str:
    """Return components for people."""
    return " and ".join(components) or "false alarm"


def briefly_named(components: Sequence[str]) -> str:
    """Return components for people, of many the first ones and how many more there are."""
    rest = len(components) - MOST_NAMED
    return f"{', '.join(components[:MOST_NAMED])} and {rest} more" if rest > 0 else named(components)


def percent(probability: float) -> str:
    """Return a probability for people."""
    return f"{100 * probability:.3g} %"


def cases_of(entries: Sequence[Mapping[str, Any]]) -> list[Case]:
    """Return entries by their causes, the most important first.

    Args:
        entries: in the form of the JSON contract (:func:`gateway.faults.service.as_dict`).
    """
    found: dict[tuple[object, ...], list[Mapping[str, Any]]] = {}
    for entry in entries:
        found.setdefault(_key(entry), []).append(entry)
    return sorted((_case(key[0] is True, group) for key, group in found.items()), key=_order)


def _key(entry: Mapping[str, Any]) -> tuple[object, ...]:
    """Return what entries of one case have in common: the proven cause, or all that may be the cause."""
    cause = entry.get("cause")
    if cause is None or not cause["components"]:
        return False, entry["fault"]
    if cause["role"] != OPEN:
        return True, *cause["components"]
    return False, *(tuple(one["components"]) for one in cause["ranked"])


def _case(proven: bool, group: Sequence[Mapping[str, Any]]) -> Case:
    entries = sorted(group, key=_place)
    latest = max(entries, key=lambda entry: entry["cause"]["t_ns"] if entry.get("cause") else 0)
    cause = latest.get("cause") or {"components": (), "probability": 0.0, "ranked": ()}
    failing = sum(_fails(entry) for entry in entries)
    return Case(tuple(cause["components"]), cause["probability"], proven, cause["ranked"], failing, entries)


def _fails(entry: Mapping[str, Any]) -> bool:
    return bool(entry["status"] & Status.TEST_FAILED)


def _place(entry: Mapping[str, Any]) -> tuple[object, ...]:
    """Return the place of an entry in its case: failing, standing for the cause, naming it, the latest."""
    cause = entry.get("cause") or {"lead": "", "role": OPEN}
    return (
        not _fails(entry),
        cause["lead"] != entry["fault"],
        cause["role"] != CAUSE,
        -(entry["last_ns"] or 0),
        entry["fault"],
    )


def _order(case: Case) -> tuple[object, ...]:
    return (not case.failing, not case.proven, -max(entry["last_ns"] or 0 for entry in case.entries), case.components)
