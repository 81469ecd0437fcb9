"""When DM1 is sent by itself (SAE J1939-73, 5.7.1): cyclically, and when a DTC becomes active or inactive."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.faults.entries import DtcChange
from gateway_testers.j1939.dtcs import CodedDtcs
from gateway_testers.j1939.messages import Coded
from gateway_testers.j1939.params import J1939Params

#: Least time between two messages for changes of one DTC (J1939-73, DM1).
_CHANGE_NS = 1_000_000_000
#: Not active, and long ago.
_NEVER_TOLD = (False, -_CHANGE_NS)


class Dm1Schedule:
    """Knows which DTCs were told and when, and so which come next.

    Args:
        params: settings.
        dtcs: the DTCs that J1939 tells of.
    """

    def __init__(self, params: J1939Params, dtcs: CodedDtcs) -> None:
        self._params = params
        self._dtcs = dtcs
        self._cyclic_ns: int | None = None  # the next one; None: at once
        self._told: dict[str, tuple[bool, int]] = {}  # fault -> active when told, and when
        self._changed: set[str] = set()

    def succeed(self, old: Dm1Schedule) -> None:
        """Keep the record of DTCs that were told already."""
        self._cyclic_ns, self._told, self._changed = old._cyclic_ns, old._told, old._changed

    def note(self, changes: Sequence[DtcChange]) -> None:
        """Note DTCs that changed."""
        self._changed |= {c.definition.id for c in changes if c.definition.spn is not None}

    def take_due(self, t_ns: int) -> list[Coded] | None:
        """Return the active DTCs, which then count as told, if DM1 is to be sent now; else None."""
        cyclic = self._cyclic_ns is None or t_ns >= self._cyclic_ns
        if not cyclic and not any(self._is_news(fault, t_ns) for fault in self._changed):
            return None
        if cyclic:
            self._set_next(t_ns)
        active = self._dtcs.active()
        if cyclic and not active and not self._params.when_clear and not self._changed:
            return None
        for fault in list(self._changed):
            if not cyclic and not self._is_news(fault, t_ns):
                continue
            self._told[fault] = self._dtcs.is_active(fault), t_ns
            self._changed.discard(fault)
        return active

    def _set_next(self, t_ns: int) -> None:
        cycle = round(self._params.cycle_ms * 1e6)
        late = self._cyclic_ns is None or t_ns - self._cyclic_ns > cycle
        self._cyclic_ns = (t_ns if late else self._cyclic_ns or 0) + cycle

    def _is_news(self, fault: str, t_ns: int) -> bool:
        """Return whether a DTC became active or inactive, and was not told of in the last second."""
        told, when = self._told.get(fault, _NEVER_TOLD)
        return self._dtcs.is_active(fault) != told and t_ns - when >= _CHANGE_NS

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`take_due` has something to tell next."""
        waiting = [self._cyclic_ns or 0]
        for fault in self._changed:
            told, when = self._told.get(fault, _NEVER_TOLD)
            if self._dtcs.is_active(fault) != told:
                waiting.append(when + _CHANGE_NS)
        return min(waiting)
