"""Restarts: starts that find the memory of a process that was not stopped, but died.

Its power cycle is open still. The memory keeps how many there were, when the last one was, and how many came in a row
without a stop or a time that went well between them, on a machine that ran all the time: a power cut is no repeated
failure of the gateway. Repeated ones make the next start wait, longer each time; it never gives up, since who can
make it die could stop it for good then.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gateway.faults.ledger import Ledger
from gateway.faults.operation_cycles import OperationCycles
from gateway.faults.settings import POWER

#: Numbers in the store: restarts; wall time of the last [ns]; its reason's place in REASONS; restarts in a row; digests
#: of the machine's boot, and of what the watchdog left beside the memory, both as the last start found them.
COUNT, LAST_NS, REASON, ROW = "restarts", "restarts.t_ns", "restarts.reason", "restarts.in_a_row"
_BOOT, _HUNG = "restarts.boot", "restarts.hung"
REASONS = (
    "the process ended without a stop",
    "the watchdog ended the process: a monitor's step did not return",
    "the machine was started again: power cut, or reboot",
)
_DIED, _HUNG_UP, _BOOTED = range(3)
#: Restarts in a row from which each start waits, and that are told as a fault.
REPEATED = 3
#: Longest wait [s]: long enough for the machine, which a start costs a second or two, and short because who makes the
#: gateway die decides how long it is blind.
LONGEST_S = 10.0
#: After each such time without a death the count of those in a row is halved [s].
WELL_S = 600.0


@dataclass(frozen=True)
class Restart:
    """A start that found no stop.

    Attributes:
        count: of all.
        in_a_row: of those without a stop, or a time that went well, between them.
        t_ns: when, of the wall clock.
        reason: in a few words.
    """

    count: int
    in_a_row: int
    t_ns: int
    reason: str

    @property
    def wait_s(self) -> float:
        """How long the gateway waits before it opens its buses [s]."""
        return float(min(2 ** (self.in_a_row - REPEATED), LONGEST_S)) if self.in_a_row >= REPEATED else 0.0


def last_restart(facts: Mapping[str, int]) -> Restart | None:
    """Return the last restart by a store's numbers; None: there was none."""
    if not facts.get(COUNT):
        return None
    reason = REASONS[facts.get(REASON, 0) % len(REASONS)]
    return Restart(facts[COUNT], facts.get(ROW, 0), facts.get(LAST_NS, 0), reason)


class Restarts:
    """Counts restarts.

    Args:
        held: the numbers, with what is to be written.
        cycles: operation cycles, as the store had them.

    Attributes:
        found: the restart that this start is; None: it is none.
    """

    def __init__(self, held: Ledger, cycles: OperationCycles) -> None:
        self._held, self._cycles = held, cycles
        self._noted = False
        self.found: Restart | None = None

    def succeed(self, old: Restarts) -> None:
        """Go on with what another one of the same process knows."""
        self._noted, self.found = old._noted, old.found

    @property
    def after_power_cut(self) -> bool:
        """Whether the machine was started again since the last process, which was not stopped."""
        return self.found is not None and self.found.reason == REASONS[_BOOTED]

    @property
    def count(self) -> int:
        """Restarts of all."""
        return self._held.fact(COUNT)

    @property
    def in_a_row(self) -> int:
        """Restarts in a row, by now."""
        return self._held.fact(ROW)

    def note(self, t_ns: int, boot: str, hung: Mapping[str, Any]) -> Restart | None:
        """Count this start, once, before its power cycle begins; returns what it found.

        Args:
            t_ns: now, of the wall clock.
            boot: the machine's boot; "": not known.
            hung: monitors whose step did not return, of all processes before.
        """
        if self._noted:
            return self.found
        self._noted = True
        booted = bool(boot) and 0 != self._replace(_BOOT, boot) != self._held.fact(_BOOT)
        hung_up = bool(hung) and self._replace(_HUNG, json.dumps(hung, sort_keys=True)) != self._held.fact(_HUNG)
        if not self._cycles.is_left_open(POWER):
            self._set_row(0)
            return None
        why = _HUNG_UP if hung_up else _BOOTED if booted else _DIED
        self._held.set_fact(COUNT, self.count + 1)
        self._set_row(0 if why == _BOOTED else self.in_a_row + 1)
        self._held.set_fact(LAST_NS, t_ns)
        self._held.set_fact(REASON, why)
        self.found = Restart(self.count, self.in_a_row, t_ns, REASONS[why])
        return self.found

    def _replace(self, name: str, text: str) -> int:
        """Keep the digest of a text; returns the one that the last start kept, 0: none."""
        before = self._held.fact(name)
        self._held.set_fact(name, int.from_bytes(hashlib.blake2b(text.encode(), digest_size=7).digest(), "big"))
        return before

    def _set_row(self, count: int) -> None:
        if count != self.in_a_row:
            self._held.set_fact(ROW, count)

    def went_well(self) -> None:
        """Halve the count of those in a row: :data:`WELL_S` went by."""
        self._set_row(self.in_a_row // 2)
