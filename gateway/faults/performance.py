"""In-use monitor performance (AUTOSAR DEM: IUMPR): how often monitors have run, of how often they could have.

Shown by J1939 DM20 and OBD mode 09, infotype 08. By 13 CCR 1968.2 (d)(4) and 1971.1 (d)(4): a monitor's numerator
counts the operation cycles in which its test came to a result, whichever, so that a failure would have been found; its
denominator those in which the vehicle was operated as the general denominator asks; the ignition counter all of them.
Each counts once a cycle, at once, and no clear resets them.
"""

from __future__ import annotations

from typing import NamedTuple

from gateway.faults.catalogue import Catalogue
from gateway.faults.ledger import Ledger
from gateway.faults.operation_cycles import OperationCycles

#: The greatest count: the greatest valid one of J1939's two bytes.
MOST = 0xFAFF
#: Numbers in the store.
IGNITION, CONDITIONS, CONDITIONS_CYCLE = "ignition_cycles", "monitoring_conditions", "monitoring_conditions.cycle"


class Ratio(NamedTuple):
    """How often a monitor has run, of how often it could have."""

    numerator: int
    denominator: int

    @property
    def order(self) -> tuple[float, int, int]:
        """Key of the one shown of several, the least: the lowest ratio, of alike ones that of more chances."""
        share = self.numerator / self.denominator if self.denominator else float("inf")
        return share, -self.denominator, self.numerator


class Performance:
    """Counts for the emission related faults whose operation cycle is the one that is asked for.

    Args:
        held: the numbers, with what is to be written.
        cycles: operation cycles.
        catalogue: the faults that are monitored.
        cycle: the operation cycle that counts; None: nothing is counted.
    """

    def __init__(self, held: Ledger, cycles: OperationCycles, catalogue: Catalogue, cycle: str | None) -> None:
        self._held, self._cycles, self._cycle = held, cycles, cycle
        self._tracked = {d.id: d for d in catalogue if d.emission_related and d.cycle == cycle}

    @property
    def offered(self) -> bool:
        """Whether anything is counted."""
        return self._cycle is not None

    @property
    def ignition_cycles(self) -> int:
        """Operation cycles begun."""
        return self._held.fact(IGNITION)

    @property
    def conditions(self) -> int:
        """General denominator: operation cycles with the conditions under which monitors can run."""
        return self._held.fact(CONDITIONS)

    def began(self, cycle: str) -> None:
        """Count an operation cycle that begins."""
        if cycle == self._cycle:
            self._roll(IGNITION)

    def completed(self, fault: str) -> None:
        """Count a test that came to a result."""
        if fault in self._tracked and self._is_first(f"numerator_cycle.{fault}"):
            self._count(fault, Ratio(1, 0))

    def conditions_met(self) -> None:
        """Count that the vehicle was operated as the general denominator asks."""
        if self._is_first(CONDITIONS_CYCLE):
            self._roll(CONDITIONS)
            for fault in self._tracked:
                self._count(fault, Ratio(0, 1))

    def _is_first(self, name: str) -> bool:
        """Return whether the operation cycle is open, and this is the first time in it."""
        if self._cycle is None or not self._cycles.is_open(self._cycle):
            return False
        number = self._cycles.number(self._cycle)
        if self._held.fact(name) == number:
            return False
        self._held.set_fact(name, number)
        return True

    def _roll(self, name: str) -> None:
        count = self._held.fact(name)
        self._held.set_fact(name, 0 if count >= MOST else count + 1)

    def _count(self, fault: str, more: Ratio) -> None:
        """Add to both counts; where one is at its end both are halved before, so that their ratio stays."""
        ratio = self.of(fault)
        if MOST in ratio:
            ratio = Ratio(ratio.numerator // 2, ratio.denominator // 2)
        self._held.set_fact(f"numerator.{fault}", ratio.numerator + more.numerator)
        self._held.set_fact(f"denominator.{fault}", ratio.denominator + more.denominator)

    def of(self, fault: str) -> Ratio:
        """Return the counts of a fault's monitor."""
        return Ratio(self._held.fact(f"numerator.{fault}"), self._held.fact(f"denominator.{fault}"))

    def by_group(self) -> dict[str, Ratio]:
        """Return the counts of each readiness group that is counted: of its monitor with the lowest ratio."""
        found: dict[str, Ratio] = {}
        for definition in self._tracked.values():
            ratio = self.of(definition.id)
            known = found.setdefault(definition.readiness, ratio)
            found[definition.readiness] = min(known, ratio, key=lambda each: each.order)
        return found
