"""A bus that comes and goes: opened, lost, opened again, without anybody else noticing more than a frame.

Its frames come in the engine's time (see ``gateway.live.stamps``). Its conditions go among them (see
``gateway.bus.conditions``): LOST when it cannot be reached, RUNNING when it can again, LOSS where frames were lost in a
queue.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from gateway.bus.base import Bus, Statistics
from gateway.bus.conditions import LOSS, LOST, RUNNING, are_conditions, condition_frame
from gateway.bus.frames import Frames, empty
from gateway.common.fence import Fence, Wall
from gateway.live.clock import Clock
from gateway.live.stamps import Stamps
from gateway.live.transmit import Transmitter
from gateway_fdi.common.log import get_logger, load
from gateway_fdi.errors import BusError, UnsupportedError

#: First and longest wait before a bus that is gone is tried again [s].
FIRST_WAIT_S, LONGEST_WAIT_S = 0.05, 0.8
#: Frames taken at one call.
BATCH = 256

log = get_logger(__name__)

#: Opens a bus: URI and index.
Opener = Callable[[str, int], Bus]


class Link:
    """A bus under supervision.

    Args:
        uri: of the bus.
        index: stamped into its frames.
        name: its name in the configuration.
        opener: opens it.
        clock: the engine's.
        monotonic: for the waits [s].
        before_close: called before its socket is closed: nobody may send by that any more.
        wall: counts what a driver raises beside :class:`BusError`; that is an end of the bus, too.

    Attributes:
        index, name: may be changed at any time.
        losses: how often it was lost.
        stamps: from those of its frames to the engine's time.
    """

    def __init__(
        self,
        uri: str,
        index: int,
        name: str,
        opener: Opener,
        clock: Clock,
        *,
        monotonic: Callable[[], float] = time.monotonic,
        before_close: Callable[[], None] = lambda: None,
        wall: Wall | None = None,
    ) -> None:
        self._wall = wall or Fence().wall("bus")
        self._before_close = before_close
        self.uri, self.index, self.name = uri, index, name
        self._opener, self._clock, self._monotonic = opener, clock, monotonic
        self.stamps = Stamps(clock, name)
        self._bus: Bus | None = None
        self._wait_s = FIRST_WAIT_S
        self._next_try = 0.0
        self._past = Statistics()
        self._filters: Sequence[int] | None = None
        self._echo = False
        self._batch = empty(BATCH)
        self._told: list[Frames] = []
        self._transmitter = Transmitter()
        self._ending = ""  # why nothing can be sent any more, while what has come is still read
        self.reason = ""
        self.losses = 0
        self.echoes = False

    def start(self) -> None:
        """Open it for the first time; one that is not there is reported LOST, and tried again.

        Raises:
            UnsupportedError: this system has no such kind of bus.
            InputError: not a URI of a bus.
        """
        load()  # not when the first line comes, with frames waiting
        try:
            self._open()
        except UnsupportedError:
            raise
        except BusError as error:
            self._lose(str(error))

    @property
    def running(self) -> bool:
        """Whether the bus is open, and takes frames."""
        return self._bus is not None and not self._ending

    def fileno(self) -> int | None:
        """Return the descriptor to wait for, None while the bus is gone."""
        return None if self._bus is None else self._bus.fileno()

    @property
    def due_s(self) -> float:
        """How long until it wants :meth:`attend`, and :meth:`receive`, at the latest [s]."""
        if self._bus is None:
            return max(self._next_try - self._monotonic(), 0.0)
        if self._ending or self._told:
            return 0.0
        return 0.001 if len(self._transmitter) else float("inf")

    def attend(self) -> None:
        """Try to open a bus that is gone, when it is time; send what waits."""
        if self._bus is None and self._monotonic() >= self._next_try:
            try:
                self._open()
            except Exception as error:  # each driver has its own
                self._drop()  # opened, and gone again before it was set up
                self._wait_s = min(2 * self._wait_s, LONGEST_WAIT_S)
                self._next_try = self._monotonic() + self._wait_s
                self.reason = self._reason(error)
        if len(self._transmitter):
            self._send(empty(0))

    def receive(self) -> tuple[Frames, bool]:
        """Take frames, and the link's conditions, in the engine's time; the frames are valid until the next call.

        Returns:
            frames; whether there may be more.
        """
        told, self._told = self._told, []
        if self._bus is None:
            self.stamps.apply(empty(0), more=False)
            return self._joined(told), False
        try:
            self._bus.index = self.index
            count = self._bus.receive(self._batch)
        except Exception as error:
            self._lose(self._reason(error))
            told += self._told
            self._told = []
            return self._joined(told), False
        return self._with_conditions(told, self._batch[:count], list(self._bus.losses), more=count == BATCH)

    def take(self, frames: Frames, more: bool) -> tuple[Frames, bool]:
        """Take frames that a pump has received, as :meth:`receive` does; its receiver was told of them.

        Args:
            frames: as its socket gave them.
            more: whether there may be more.
        """
        raw = None if self._bus is None else self._bus.raw
        assert raw is not None, "no pump receives from this bus"
        frames["bus"] = self.index
        return self._with_conditions([], frames, list(raw.losses), more=more)

    def _with_conditions(
        self, told: list[Frames], frames: Frames, losses: list[tuple[int, int]], *, more: bool
    ) -> tuple[Frames, bool]:
        assert self._bus is not None, "there are frames of a bus"
        self.stamps.apply(frames, more=more)
        forged = are_conditions(frames)
        if forged.any():  # only we report conditions of our clock and our links
            self._bus.statistics.rejected += int(forged.sum())
            losses = [(place - int(forged[:place].sum()), lost) for place, lost in losses]
            frames = frames[~forged]
        if losses:
            frames = self._with_losses(frames, losses)
        if self._ending and not more:
            self._lose(self._ending)
            frames = self._joined([*told, frames, *self._told])
            self._told = []
            return frames, False
        return (self._joined([*told, frames]) if told else frames), more

    @property
    def pumped(self) -> Bus | None:
        """The bus, of whose socket a pump may receive now; None: only :meth:`receive` may."""
        bus = self._bus
        if bus is None or bus.raw is None or self._ending or self._told or len(self._transmitter):
            return None
        return bus if self.stamps.plain else None

    def _joined(self, parts: list[Frames]) -> Frames:
        frames = np.concatenate([empty(0), *parts])
        frames["bus"] = self.index  # it may have changed since something happened
        return frames

    def send(self, frames: Frames) -> None:
        """Send frames; those of a bus that is gone are given up."""
        if self.running:
            self._send(frames)
        else:
            self._transmitter.given_up += len(frames)

    def _send(self, frames: Frames) -> None:
        if self._bus is None or self._ending:
            return
        try:
            self._transmitter.send(self._bus, frames)
        except Exception as error:
            self._end(self._reason(error))

    def listen_to(self, can_ids: Sequence[int] | None, *, echo: bool) -> None:
        """Choose what comes: identifiers (None: all), and whether what is sent here comes back."""
        self._filters, self._echo = can_ids, echo
        try:
            self._choose()
        except Exception as error:
            self._end(self._reason(error))

    def _reason(self, error: Exception) -> str:
        """Return why the bus is gone; what no driver should raise is counted."""
        return str(error) if isinstance(error, BusError) else self._wall.caught(error, self.name)

    def _choose(self) -> None:
        if self._bus is not None:
            self._bus.set_filters(self._filters)
            self.echoes = self._bus.set_echo(self._echo) if self._echo or self.echoes else False

    @property
    def statistics(self) -> Statistics:
        """Counters of the bus since the start, over all its lives."""
        total = Statistics()
        for part in (self._past, None if self._bus is None else self._bus.statistics):
            if part is not None:
                _add(total, part)
        return total

    @property
    def unsent(self) -> int:
        """Frames that were never sent: the bus was gone, or its queue full for too long."""
        return self._transmitter.given_up

    def close(self) -> None:
        """Close the bus."""
        if self._bus is not None:
            self._drop()

    def _open(self) -> None:
        self._bus = self._opener(self.uri, self.index)
        self.stamps = Stamps(self._clock, self.name, own_clock=self._bus.own_clock)
        self._wait_s = FIRST_WAIT_S
        self.reason = ""
        self._choose()
        if self.losses:
            log.info("bus is back", bus=self.name, uri=self.uri)
        self._told.append(condition_frame(self._clock.now(), self.index, RUNNING))

    def _lose(self, reason: str) -> None:
        log.warning("bus lost", bus=self.name, uri=self.uri, reason=reason)
        self._drop()
        self.losses += 1
        self.reason = reason
        self._transmitter.give_up()
        self._next_try = self._monotonic() + self._wait_s
        self._told.append(condition_frame(self._clock.now(), self.index, LOST))

    def _end(self, reason: str) -> None:
        """Note that the bus is gone; it is lost when all that had come before is read."""
        self._ending = self._ending or reason
        self._transmitter.give_up()

    def _drop(self) -> None:
        if self._bus is not None:
            self._before_close()
            _add(self._past, self._bus.statistics)
            bus, self._bus, self._ending = self._bus, None, ""
            self._wall.keep(bus.close, of=self.name)

    def _with_losses(self, frames: Frames, losses: Sequence[tuple[int, int]]) -> Frames:
        """Return the frames with LOSS where frames are missing."""
        parts, at = [], 0
        for place, lost in losses:
            parts.append(frames[at:place])
            t_ns = int(frames[place]["t_ns"]) if place < len(frames) else self._clock.now()
            parts.append(condition_frame(t_ns, self.index, LOSS, lost))
            at = place
        return np.concatenate([*parts, frames[at:]])


def bus_event(link: Link, state: str, t_ns: int) -> dict[str, Any]:
    """Return the event of the JSON contract that tells the state of a bus at a time of the wall clock."""
    return {
        "event": "bus",
        "t_ns": t_ns,
        "bus": link.name,
        "uri": link.uri,
        "state": state,
        **asdict(link.statistics),
        "unsent": link.unsent,
        "losses": link.losses,
        "reason": link.reason,
    }


def _add(total: Statistics, part: Statistics) -> None:
    for field in fields(Statistics):
        setattr(total, field.name, getattr(total, field.name) + getattr(part, field.name))
