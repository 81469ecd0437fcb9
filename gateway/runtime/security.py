"""Security events: what a sensor of the gateway saw that a healthy bus does not do, told at a bounded rate.

The fields are those of a qualified security event of AUTOSAR's IdsM (intrusion detection system manager): the sensor,
its event, how many of them it stands for, and context data. Its filters are here, too: the first event of a kind is
told at once, further ones at most once in :data:`EVERY_NS`, with their count (aggregation); kinds beyond :data:`MOST`
have one place together (rate limitation). None disappears without a count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from gateway_fdi.common.log import get_logger

#: Least time between two told events of a sensor and kind [ns].
EVERY_NS = 1_000_000_000
#: Sensors and kinds that are kept apart; further ones are those of :data:`OTHERS`.
MOST = 256
OTHERS = ("others", "others")

_log = get_logger(__name__)


@dataclass
class _Kind:
    """Events of a sensor and kind: when the last was told, what waits since, and how many there were."""

    told_ns: int
    waiting: int = 0
    total: int = 0
    context: Mapping[str, Any] = field(default_factory=dict)


class Security:
    """Takes the events of sensors, and tells them at a bounded rate.

    Args:
        report: takes events of the JSON contract.
    """

    def __init__(self, report: Callable[[dict[str, Any]], None]) -> None:
        self._report = report
        self._kinds: dict[tuple[str, str], _Kind] = {}

    def succeed(self, old: Security) -> None:
        """Go on with the counts of an earlier configuration."""
        self._kinds = old._kinds

    def note(self, t_ns: int, sensor: str, event: str, context: Mapping[str, Any], count: int = 1) -> None:
        """Take an event, and tell it if it is time.

        Args:
            t_ns: when, of the wall clock [ns].
            sensor: that saw it: a bus, or ``bus.MESSAGE``.
            event: its kind: ``early``, ``second_sender``, ``unknown``, ``mac``, ...
            context: data beside it, for JSON.
            count: how many it stands for.
        """
        key = (sensor, event)
        if key not in self._kinds and len(self._kinds) >= MOST:
            key, context = OTHERS, {"sensor": sensor, "event": event, **context}
        kind = self._kinds.setdefault(key, _Kind(t_ns - EVERY_NS))
        kind.waiting += count
        kind.total += count
        kind.context = context
        self._settle(key, kind, t_ns)

    def pass_time(self, t_ns: int, *, final: bool = False) -> None:
        """Tell what waits and is due; ``final``: all that waits.

        Args:
            t_ns: now, of the wall clock [ns].
            final: at the end.
        """
        for key, kind in self._kinds.items():
            self._settle(key, kind, t_ns, final=final)

    def counters(self) -> dict[str, int]:
        """Return how many events there were, if there were any."""
        total = sum(kind.total for kind in self._kinds.values())
        return {"security_events": total} if total else {}

    def _settle(self, key: tuple[str, str], kind: _Kind, t_ns: int, *, final: bool = False) -> None:
        # A clock that was set back must not silence it.
        if not kind.waiting or not (final or abs(t_ns - kind.told_ns) >= EVERY_NS):
            return
        told = {"sensor": key[0], "kind": key[1], "count": kind.waiting, "total": kind.total}
        kind.told_ns, kind.waiting = t_ns, 0
        _log.warning("security event", **told, **{f"context_{name}": value for name, value in kind.context.items()})
        self._report({"event": "security", "t_ns": t_ns, **told, "context": dict(kind.context)})
