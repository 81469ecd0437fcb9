"""A gateway of which all is kept that it tells: behind sessions, replays and scenarios."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from gateway.config.model import Config
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import Parts, prepare
from gateway_api.run import Event, Run, SeriesSet, tables_of
from gateway_api.words import plain
from gateway_replay.series.gather import Gatherer
from gateway_replay.series.rows import Rows
from gateway_replay.series.rows import Series as Which


class _Keep:
    """A sink of series that keeps them."""

    def __init__(self) -> None:
        self.rows: list[Rows] = []
        self.known: Sequence[Which] = ()

    def write(self, rows: Rows, series: Sequence[Which]) -> None:
        self.rows.append(rows)
        self.known = series

    def close(self) -> None:
        pass


class EventCollector:
    """A gateway, its events, and its series where they are wanted.

    Args:
        config: the configuration.
        file: of it, for errors.
        parts: of it, if they are there already.
        memory: file of the fault memory; None: in this process only.
        series: whether series are kept.
        signals: that are kept with them.
        lasting: whether batches are not written to after they were fed.

    Attributes:
        fed: takes frames, and lets time pass.
        begin_ns: stamp of the first frame; set by the caller that feeds it [ns].
        notes: remarks for people.

    Raises:
        InputError, InputErrors: a database, message, signal or fault that is wrong.
    """

    def __init__(
        self,
        config: Config,
        file: Path | None,
        *,
        parts: Parts | None = None,
        memory: Path | None = None,
        series: bool = False,
        signals: Sequence[str] = (),
        lasting: bool = False,
    ) -> None:
        self.parts = prepare(config, file, extra=signals) if parts is None else parts
        self.gateway = Gateway(config, memory, file=file, parts=self.parts, lasting=lasting)
        self.events: list[Event] = []
        self.notes: list[str] = []
        self.begin_ns = 0
        self.gateway.listen(self.events.append)
        self._keep = _Keep() if series or signals else None
        self.fed: Gateway | Gatherer = self.gateway
        if self._keep is not None:
            slots = {name: self.parts.slots[name] for name in dict.fromkeys(signals)}
            self.fed = Gatherer(self.gateway, [self._keep], slots)
        self._begun = time.monotonic()

    def run(self, frames: int) -> Run:
        """Return what has come of it so far.

        Args:
            frames: that were fed.
        """
        kept = None
        if isinstance(self.fed, Gatherer) and self._keep is not None:
            self.fed.close()
            kept = SeriesSet(tuple(self._keep.rows), tuple(self._keep.known), self.begin_ns)
        return Run(
            self.gateway.config.name,
            self.begin_ns,
            frames,
            tuple(self.events),
            self.gateway.summary(time.monotonic() - self._begun),
            *tables_of(self.gateway, self.begin_ns),
            notes=tuple(plain(text) for text in self.notes),
            kept=kept,
        )

    def close(self) -> None:
        """Close the gateway."""
        self.gateway.close()
