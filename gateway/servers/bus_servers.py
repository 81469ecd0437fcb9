"""All servers of a gateway together: frames for them, times when they are due, frames that they may send."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gateway.bus.frames import URGENT, Frames, empty
from gateway.bus.id_filter import IdFilter
from gateway.common.fence import Fence
from gateway.common.times import NEVER
from gateway.faults.entries import DtcChange
from gateway.servers.bus_server import BusServer

_NOBODY = np.void(b"")
#: Time that a server has no turn after an exception that ended no single tester: it may come again at once [ns].
REST_NS = 100_000_000


class BusServers:
    """The servers, in the order in which they send.

    Args:
        servers: each reads no clock: times come with the calls.
        buses: how many the gateway has.
        may_send: whether normal communication is on at present (ISO 14229-1, 0x28).
        fence: counts their exceptions.

    Attributes:
        heard: what they listen to, on any bus.
    """

    def __init__(
        self, servers: Sequence[BusServer], buses: int, may_send: Callable[[], bool], fence: Fence | None = None
    ) -> None:
        self.all = tuple(servers)
        self._may_send = may_send
        self._now_ns = 0
        fence = fence or Fence()
        for server in self.all:
            server.wall = fence.wall(server.door)
        self._due = [server.next_ns for server in self.all]
        self._next_due = min(self._due, default=NEVER)
        ids = [server.identifiers(bus) or [] for server in self.all for bus in range(buses)]
        self.heard = IdFilter(frozenset().union(*ids), frozenset().union(*(server.masks for server in self.all)))

    def identifiers_on(self, bus: int) -> list[int] | None:
        """Return the identifiers (with EXTENDED) that they listen to on a bus; None: they are too many to list."""
        found: list[int] = []
        for server in self.all:
            more = server.identifiers(bus)
            if more is None:
                return None
            found += more
        return found

    def succeed(self, old: BusServers, buses: Mapping[int, int]) -> None:
        """Go on where those of another configuration stop.

        Args:
            old: not to be used any more.
            buses: index of a bus there -> its index here.
        """
        for k, server in enumerate(self.all):
            for other in old.all:
                server.succeed(other, buses)
            self._set_due(k)

    def indifferent(self, frames: Frames) -> bool:
        """Return whether a batch is for no server by its identifiers alone, as most are; others are cut."""
        return self.heard.has_none_of(frames)

    def pieces(self, frames: Frames) -> Iterator[tuple[Frames, np.void, list[int]]]:
        """Cut a batch after each frame that is for a server, which sees the memory as it is then.

        Yields:
            a piece, its last frame, and the indices of the servers that this frame is for.
        """
        masks = [(k, server.wanted(frames)) for k, server in enumerate(self.all)]
        known = [(k, mask) for k, mask in masks if mask is not None and mask.any()]
        start = 0
        if known:
            for stop in np.flatnonzero(np.logical_or.reduce([mask for _, mask in known])):
                wanting = [k for k, mask in known if mask[stop]]
                yield frames[start : stop + 1], frames[stop], wanting
                start = int(stop) + 1
        if start < len(frames) or not len(frames):
            yield frames[start:], _NOBODY, []

    def on_frame(self, k: int, frame: np.void, t_ns: int) -> Frames:
        """Give a server a frame that it wanted; returns frames to send."""
        return self._done(k, t_ns, self.all[k].on_frame, frame, t_ns)

    def promise(self, frames: Frames, t_ns: int) -> list[Frames]:
        """Return frames that have testers wait, whose requests are among frames that are fed later."""
        made = []
        for server in self.all:
            mask = server.wanted(frames)
            for k in () if mask is None else np.flatnonzero(mask):
                promised = server.wall.keep(server.promise, frames[k], t_ns, of=server, instead=empty(0))
                made.append(self._allowed(server, promised))
        return made

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> list[Frames]:
        """Tell all of changes that are durable; returns frames to send."""
        frames = []
        for k, server in enumerate(self.all if changes else ()):
            frames.append(self._done(k, t_ns, server.on_changes, changes, t_ns))
        return frames

    def on_time(self, t_ns: int, *, prompt: bool = False) -> list[Frames]:
        """Let time pass for those that are due; returns frames to send.

        Args:
            t_ns: now.
            prompt: only for those whose time is that of the bus; the monitors' time lags it.
        """
        if t_ns < self._next_due:
            return []
        frames = []
        for k, server in enumerate(self.all):
            if t_ns >= self._due[k] and (server.prompt or not prompt):
                frames.append(self._done(k, t_ns, server.on_time, t_ns))
        return frames

    @property
    def next_ns(self) -> int:
        """When the first of them is due."""
        return self._next_due

    @property
    def next_prompt_ns(self) -> int:
        """When the first of those is due whose time is that of the bus."""
        due = [at for at, server in zip(self._due, self.all, strict=True) if server.prompt]
        return min(due, default=NEVER)

    def counters(self) -> dict[str, int]:
        """Return what they counted, by name."""
        counters: dict[str, int] = {}
        for server in self.all:
            for name, count in server.counters().items():
                counters[name] = counters.get(name, 0) + count
        return counters

    def wake(self, server: BusServer) -> None:
        """Look again when a server is due: something came to it by no bus."""
        self._set_due(self.all.index(server))

    def _done(self, k: int, t_ns: int, work: Callable[..., Frames], *arguments: Any) -> Frames:
        """Have a server do something; returns the frames to send. One that fails drops what it had under way."""
        self._now_ns = t_ns
        server = self.all[k]
        made: Frames | None = server.wall.keep(work, *arguments, of=server, ends=self._restart)
        if made is None:
            return empty(0)
        self._set_due(k)
        return self._allowed(server, made)

    def _restart(self, server: BusServer) -> None:
        self._due[self.all.index(server)] = self._now_ns + REST_NS
        self._next_due = min(self._due)
        server.restart()

    def _set_due(self, k: int) -> None:
        server = self.all[k]
        self._due[k] = server.wall.keep(_next_of, server, of=server, instead=self._now_ns + REST_NS)
        self._next_due = min(self._due)

    def _allowed(self, server: BusServer, frames: Frames) -> Frames:
        """Return frames, unless a tester has switched normal communication off."""
        if server.normal and not self._may_send():
            return empty(0)
        if server.urgent:
            frames["rank"] = URGENT
        return frames


def _next_of(server: BusServer) -> int:
    return server.next_ns
