"""The signals that names in a configuration stand for."""

from __future__ import annotations

from collections.abc import Mapping

from gateway.config.model import Config
from gateway.engine.gate import NOW, Condition
from gateway.faults.settings import ConditionSettings
from gateway.signals.database import Database
from gateway.signals.tables import SignalRef
from gateway_fdi.errors import InputError, nearest, under


class Names:
    """Finds the signals that names in a configuration stand for, and the live values of monitors.

    Args:
        config: the configuration.
        databases: by bus.
        readouts: monitor -> what it shows of its state.

    Attributes:
        found: signal by each name.
        live: monitor and value by each name that stands for a live value.
    """

    def __init__(
        self, config: Config, databases: Mapping[int, Database], readouts: Mapping[str, tuple[str, ...]] | None = None
    ) -> None:
        self._config = config
        self._databases = databases
        self._readouts = readouts or {}
        self.live: dict[str, tuple[str, str]] = {}
        self._identifiers = {did.name: did for did in config.did}
        self.found: dict[str, SignalRef] = {}

    def find(self, name: str, key: str) -> SignalRef:
        """Return a signal by ``bus.Message.Signal``, or ``Message.Signal`` of the first bus that has it.

        Raises:
            InputError: there is none; names the key.
        """
        if name not in self.found:
            with under(key, name):
                self.found[name] = self._resolve(name)
        return self.found[name]

    def find_shown(self, name: str, key: str) -> None:
        """Find what an identifier reads, or a freeze frame keeps: a signal, or a live value, ``monitor:value``.

        Raises:
            InputError: there is no such thing; names the key.
        """
        did = self._identifiers.get(name)
        monitor, colon, value = (name if did is None or did.signal is None else did.signal).partition(":")
        if not colon:
            self.find(name, key)
            return
        for what, one, known in (
            ("monitors are", monitor, tuple(self._readouts)),
            (f"live values of {monitor} are", value, self._readouts.get(monitor, ())),
        ):
            if one not in known:
                text = f"the {what} {', '.join(known) or 'none'}{nearest(one, known)}"
                raise InputError(text, key=key, value=name)
        self.live[name] = (monitor, value)

    def _resolve(self, name: str) -> SignalRef:
        did = self._identifiers.get(name)
        if did is not None:
            if did.signal is None:
                raise InputError("this identifier is no signal, and never changes", value=name)
            name = did.signal
        parts = name.split(".")
        if len(parts) not in (2, 3):
            raise InputError('a signal is named "Message.Signal" or "bus.Message.Signal"')
        message, signal = parts[-2:]
        if len(parts) == 3:
            buses = [self._config.bus_index(parts[0])]
        else:
            having = [k for k in self._databases if self._has(k, message)]
            buses = having or list(self._databases)
        self._databases[buses[0]].signal(message, signal)
        return SignalRef(buses[0], message, signal)

    def _has(self, bus: int, message: str) -> bool:
        return self._databases[bus].has(message)

    def condition(self, settings: ConditionSettings, key: str, counts: int = NOW) -> Condition:
        """Return a condition of the configuration for the engine, and how it counts."""
        low = float("-inf") if settings.min is None else settings.min
        high = float("inf") if settings.max is None else settings.max
        return Condition(self.find(settings.signal, f"{key}.signal"), low, high, settings.rise, counts)
