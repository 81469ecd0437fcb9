"""Checksums' rules that have been proven: the fault memory keeps them, so that the next ignition knows them.

A sender whose checksum breaks over night is to be accused itself, not the rule that it has fitted for years. A digest
of the rule is kept: another rule has to be proven first.
"""

from __future__ import annotations

from gateway.engine.core import Engine
from gateway.faults.memory import FaultMemory


class Proofs:
    """Carries proofs between an engine and a fault memory.

    Args:
        engine: proves rules.
        memory: keeps the proofs.
    """

    def __init__(self, engine: Engine, memory: FaultMemory) -> None:
        self._engine, self._memory = engine, memory
        self._rules = engine.rules()

    def recall(self) -> None:
        """Let the engine know the proven rules; proofs of rules that have changed since are dropped."""
        for name, digest in self._rules.items():
            kept = self._memory.proven(name)
            if kept == digest:
                self._engine.take_as_proven(name)
            elif kept:
                self._memory.keep_proven(name, 0)

    def look(self) -> None:
        """Have the memory keep what has been proven since; it is written with the next commit."""
        for name in self._engine.proven():
            self._memory.keep_proven(name, self._rules[name])
