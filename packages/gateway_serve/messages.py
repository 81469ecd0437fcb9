"""Messages as they are on the buses: names and signals by the configuration's databases, periods as measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import EXTENDED, ID_MASK
from gateway.bus.traffic import Seen
from gateway.signals.database import load_database
from gateway.signals.keys import can_id_of, is_alone, is_woven
from gateway_fdi.errors import InputError

#: Signals of one message that are shown.
MOST_SIGNALS = 64


class MessageNames:
    """Knows the messages of each bus; a database that cannot be read is left out, and told.

    Args:
        buses: as the status socket's hello has them.
    """

    def __init__(self, buses: Sequence[Mapping[str, Any]]) -> None:
        self._buses = [str(bus["name"]) for bus in buses]
        self._known: dict[tuple[int, int], Any] = {}
        self._units: dict[str, str | None] = {}
        self.wrong: list[str] = []
        for k, bus in enumerate(buses):
            if not bus["database"]:
                continue
            try:
                database = load_database([Path(path) for path in bus["database"]])
            except InputError as error:
                self.wrong.append(str(error))
                continue
            for message in database:
                self._known[k, can_id_of(message)] = message
                for signal in message.signals:
                    for prefix in ("", f"{bus['name']}."):
                        self._units.setdefault(f"{prefix}{message.name}.{signal.name}", signal.unit or None)

    def unit(self, signal: str) -> str | None:
        """Return the unit of a signal by its full name; None: it has none, or is not in the databases."""
        return self._units.get(signal)

    def shown(self, block: bytes, now_ns: int) -> list[dict[str, Any]]:
        """Return what is shown of each identifier.

        Args:
            block: rows of :class:`gateway.bus.traffic.Seen`.
            now_ns: the time of these rows, of the frames' clock.
        """
        rows = np.frombuffer(block, Seen.dtype)
        return [self._row(row, now_ns) for row in rows]

    def _row(self, row: np.void, now_ns: int) -> dict[str, Any]:
        bus, can_id = int(row["bus"]), int(row["can_id"])
        message = self._known.get((bus, can_id))
        gaps = int(row["gaps"])
        payload = row["words"].tobytes()[: int(row["length"])]
        return {
            "bus": self._buses[bus] if bus < len(self._buses) else str(bus),
            "id": f"{can_id & ID_MASK:08X}" if can_id & EXTENDED else f"{can_id & 0x7FF:03X}",
            "name": None if message is None else message.name,
            "sender": None if message is None or not message.senders else message.senders[0],
            "expected_ms": None if message is None else message.cycle_time,
            "count": int(row["count"]),
            "period_ms": row["sum_ns"] / gaps / 1e6 if gaps else None,
            "shortest_ms": row["shortest_ns"] / 1e6 if gaps else None,
            "longest_ms": row["longest_ns"] / 1e6 if gaps else None,
            "age_ms": max(now_ns - int(row["last_ns"]), 0) / 1e6,
            "data": payload.hex(" "),
            "signals": _signals(message, payload) if message and is_alone(message, is_woven(message, False)) else [],
        }


def _signals(message: Any, payload: bytes) -> list[list[Any]]:
    """Return name, value or text, and unit of each signal of a payload."""
    try:
        decoded = message.decode(payload, decode_choices=True, allow_truncated=True)
    except Exception:  # a payload that does not fit its database is shown as it is
        return []
    if not isinstance(decoded, dict):
        return []
    units = {signal.name: signal.unit or "" for signal in message.signals}
    shown: list[list[Any]] = []
    for name, value in list(decoded.items())[:MOST_SIGNALS]:
        number = isinstance(value, int | float)
        told = (value if math.isfinite(value) else None) if number else str(value)
        shown.append([name, told, units.get(name, "")])
    return shown
