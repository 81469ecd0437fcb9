"""Checksums' rules that have been proven: the fault memory keeps them, so that the next ignition knows them.

A sender whose checksum breaks over night is to be accused itself, not the rule that it has fitted for years. A digest
of the rule is kept: another rule has to be proven first. With it goes the freshness value of SecOC, so that what was
sent before a restart is not new after it.
"""

from __future__ import annotations

from gateway.engine.core import Engine
from gateway.faults.memory import FaultMemory

#: By how much a freshness value rises before it is kept again: each time is a change of the file. At the end all are.
STEP = 1024


class Proofs:
    """Carries proofs between an engine and a fault memory."""

    def __init__(self, engine: Engine, memory: FaultMemory) -> None:
        self._engine, self._memory = engine, memory
        self._rules = engine.rules()

    def recall(self) -> None:
        """Let the engine know the proven rules; proofs of rules that have changed since are dropped."""
        for name, digest in self._rules.items():
            kept = self._memory.proven(name)
            if kept == digest:
                self._engine.take_as_proven(name)
                self._engine.take_freshness(name, self._memory.freshness(name))
            elif kept:
                self._memory.keep_proven(name, 0)
                self._memory.keep_freshness(name, 0)

    def look(self, *, final: bool = False) -> None:
        """Have the memory keep what has been proven since, and freshness; it is written with the next commit.

        Args:
            final: the freshness values as they are, not only those that have risen by :data:`STEP`.
        """
        proven = self._engine.proven()
        for name in proven:
            self._memory.keep_proven(name, self._rules[name])
        for name, least in self._engine.freshness().items():
            if name in proven and (final or least >= self._memory.freshness(name) + STEP):
                self._memory.keep_freshness(name, least)
