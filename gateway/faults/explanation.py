"""Explanation of an entry of the fault memory: the components at fault, and the entry's part in that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

#: Parts that an entry can have: nothing is proven; its fault names a component of the proven cause; it only shows it.
OPEN, CAUSE, SYMPTOM = "open", "cause", "symptom"
ROLES = (OPEN, CAUSE, SYMPTOM)
#: Whether its confirmation waits for what explains it, or is held by a proven cause.
WAITING, HELD = "waiting", "held"
HOLDS = ("", WAITING, HELD)
#: Causes that are kept of an entry.
MOST_RANKED = 3


class Ranked(NamedTuple):
    """Components that together explain what failed, none: a false alarm; and how probable that is."""

    components: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class Cause:
    """Explanation of an entry, as was known last while it failed.

    Attributes:
        role: of :data:`ROLES`.
        ranked: likeliest first, at least one; the first is the cause where one is proven.
        lead: id of the fault whose entry stands for the proven cause: it names it, or else sees it best; "": none.
        lead_dtc: its DTC at that time.
        t_ns: since when that is known, of the wall clock.
    """

    role: str
    ranked: tuple[Ranked, ...]
    lead: str
    lead_dtc: str
    t_ns: int

    @property
    def proven(self) -> bool:
        """Whether the first of the causes is certain."""
        return self.role != OPEN

    @property
    def components(self) -> tuple[str, ...]:
        """Components of the likeliest cause."""
        return self.ranked[0].components

    @property
    def probability(self) -> float:
        """Probability of the likeliest cause."""
        return self.ranked[0].probability

    def same(self, other: Cause | None) -> bool:
        """Return whether another one says the same, whenever it was known."""
        return other is not None and (self.role, self.ranked, self.lead) == (other.role, other.ranked, other.lead)

    def as_dict(self) -> dict[str, Any]:
        """Return it in the form of the JSON contract."""
        return {
            "role": self.role,
            "components": list(self.components),
            "probability": self.probability,
            "ranked": [{"components": list(one.components), "probability": one.probability} for one in self.ranked],
            "lead": self.lead,
            "lead_dtc": self.lead_dtc,
            "t_ns": self.t_ns,
        }

    @classmethod
    def parse(cls, told: Any) -> Cause:
        """Read what :meth:`as_dict` returned.

        Raises:
            ValueError: it is no such thing.
        """
        try:
            ranked = tuple(
                Ranked(tuple(_text(name) for name in one["components"]), _probability(one["probability"]))
                for one in told["ranked"]
            )
            made = cls(_text(told["role"]), ranked, _text(told["lead"]), _text(told["lead_dtc"]), told["t_ns"])
        except (KeyError, TypeError) as error:
            raise ValueError(f"no cause: {told!r}") from error
        if made.role not in ROLES or not ranked or type(made.t_ns) is not int:
            raise ValueError(f"no cause: {told!r}")
        return made


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(value)
    return value


def _probability(value: object) -> float:
    if not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise ValueError(f"no probability: {value!r}")
    return float(value)
