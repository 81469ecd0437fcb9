"""Parts that the engine is built of, named by the user: configured monitors, and the faults that result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from gateway.monitors.contract import Fault, Monitor, MonitorParams

if TYPE_CHECKING:
    from cantools.database.can import Message


@dataclass(frozen=True)
class MonitorInstance:
    """A configured monitor: its name, type, parameters, bus, and place in the order of priority.

    ``signals`` maps a default ``"Message.Signal"`` to the user's own, or to ``"bus.Message.Signal"`` of another bus;
    ``priority`` 0 steps first.
    ``part`` tells several of one name apart, that are parts of one configured monitor.
    ``emission`` is the message its results are sent in; None: they are not sent.
    ``trusted``: whether a person says that the indices of its kernel need no check, as its author does.
    ``key`` is where the configuration has it, for errors.
    """

    name: str
    monitor: Monitor[Any]
    params: MonitorParams
    bus: int = 0
    priority: int = 0
    signals: Mapping[str, str] = field(default_factory=dict)
    emission: Message | None = None
    part: str = ""
    key: str = ""
    trusted: bool = False

    @property
    def entry(self) -> int:
        """Address of its compiled kernel; of one from outside with every index checked, unless it is trusted.

        Raises:
            InputError: it cannot be compiled.
        """
        trusted = not self.monitor.outside or (self.monitor.trusted and self.trusted)
        return self.monitor.entry if trusted else self.monitor.checked_entry


@dataclass(frozen=True)
class FaultSlot:
    """One fault of the engine: its id, definition, and the bus it was found on."""

    id: str
    fault: Fault
    bus: int
