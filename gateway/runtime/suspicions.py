"""Suspicions of monitors (capability Suspects): told, but neither stored nor a fault."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from gateway.engine.core import Engine
from gateway.monitors.contract import Suspects


class Note(Protocol):
    """Takes a suspicion: time of the wall clock [ns], monitor, kind, data beside it, how many it stands for."""

    def __call__(self, t_ns: int, sensor: str, event: str, context: Mapping[str, Any], count: int = 1) -> None:
        """Take it."""


class Suspicions:
    """Looks for new suspicions of an engine's monitors."""

    def __init__(self, engine: Engine, note: Note) -> None:
        self._engine, self._note = engine, note
        self._watched = [
            (k, found, [*found.names(instance.params)])
            for k, instance in enumerate(engine.monitors)
            if (found := instance.monitor.capability(Suspects)) is not None
        ]
        self._told = {k: 0 for k, _, _ in self._watched}

    def succeed(self) -> None:
        """Take what the engine has adopted to be told."""
        for k, found, _ in self._watched:
            self._told[k] = int(self._engine.state_of(k)[0][found.count])

    def look(self) -> None:
        """Tell what is new."""
        for k, found, names in self._watched:
            state = self._engine.state_of(k)[0]
            count = int(state[found.count])
            if count == self._told[k]:
                continue
            new, self._told[k] = count - self._told[k], count
            instance = self._engine.monitors[k]
            t_ns = self._engine.wall_ns(int(state[found.when_ns]))
            context = {"message": names[int(state[found.which]) - 1]}
            self._note(t_ns, instance.name, instance.monitor.type, context, new)
