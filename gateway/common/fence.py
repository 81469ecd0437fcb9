"""Walls between what comes from outside and the daemon's loop: an exception costs its peer, never the service.

The *first wall* stands around the work for one peer: a connection, a line, a datagram, a request, an answer of an ECU.
An exception there ends that peer, or is answered as an internal error. The *second wall* stands in the loop, for what
nobody thought of: it costs the door its turn. Both are counted by door, and told by
:mod:`gateway.runtime.exception_events`.
KeyboardInterrupt and SystemExit go through both; MemoryError does not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, TypeVar

from gateway_fdi.common.log import get_logger

#: Kinds of exceptions that are kept apart until they are told, and that are logged with their way, at most.
MOST = 64
#: Steps of the way to an exception that are logged, and letters of a peer's name.
STEPS, LETTERS = 8, 80

T = TypeVar("T")

_log = get_logger(__name__)


class Kind(NamedTuple):
    """Exceptions that are told together.

    Attributes:
        second: whether only the second wall caught them.
        door: where they came from: "doip", "status", "report", "uds", ...
        exception: the type.
        place: file and line that raised it.
    """

    second: bool
    door: str
    exception: str
    place: str


@dataclass
class Caught:
    """How many of a kind were caught since they were told, and whose work the last one ended."""

    count: int
    peer: str


class Fence:
    """All walls of one process.

    Attributes:
        first, second: exceptions that each wall caught, by door.
    """

    def __init__(self) -> None:
        self.first: Counter[str] = Counter()
        self.second: Counter[str] = Counter()
        self._news: dict[Kind, Caught] = {}
        self._logged: set[Kind] = set()

    def wall(self, door: str) -> Wall:
        """Return the first wall of a door."""
        return Wall(self, door)

    def note(self, door: str, error: Exception, peer: object = "", *, second: bool = False) -> None:
        """Count an exception; the first of its kind is logged at once.

        Args:
            door: where it came from.
            error: the exception.
            peer: whose work it ended; its text names it.
            second: whether only the second wall caught it.
        """
        (self.second if second else self.first)[door] += 1
        way = _way(error.__traceback__)
        kind = Kind(second, door, type(error).__name__, way[-1] if way else "")
        name = _named(peer)
        if kind not in self._logged and len(self._logged) < MOST:
            self._logged.add(kind)
            text = "an exception reached the loop" if second else "an exception ended the work for a peer"
            told = {"door": door, "peer": name, "exception": kind.exception, "reason": _named(error)}
            _log.error(text, **told, way=" > ".join(way[-STEPS:]))
        if kind not in self._news and len(self._news) >= MOST:
            kind = Kind(second, "others", "others", "")
        known = self._news.setdefault(kind, Caught(0, ""))
        known.count, known.peer = known.count + 1, name

    def take(self) -> dict[Kind, Caught]:
        """Return what was caught since the last call."""
        news, self._news = self._news, {}
        return news

    @property
    def has_news(self) -> bool:
        """Whether anything was caught since it was told."""
        return bool(self._news)

    def counters(self) -> dict[str, int]:
        """Return how many exceptions were caught, by wall and door, if there were any."""
        found = {f"exceptions_{door}": count for door, count in self.first.items()}
        return found | {f"second_wall_{door}": count for door, count in self.second.items()}


class Wall:
    """The first wall of one door."""

    def __init__(self, fence: Fence, door: str) -> None:
        self.fence, self.door = fence, door

    def keep(
        self,
        work: Callable[..., T],
        *arguments: Any,
        of: object = "",
        ends: Callable[[Any], object] | None = None,
        instead: Any = None,
    ) -> T:
        """Do work for a peer; an exception ends the peer.

        Args:
            work: called with ``arguments``.
            arguments: of the work.
            of: the peer; its text names it.
            ends: closes the peer, which it is called with; what it raises is caught, too.
            instead: returned where there was an exception.
        """
        try:
            return work(*arguments)
        except Exception as error:
            self.fence.note(self.door, error, of)
        if ends is not None:
            self.keep(ends, of, of=of)
        return instead  # type: ignore[no-any-return]

    def caught(self, error: Exception, peer: object = "") -> str:
        """Count an exception that the caller has caught; returns its text."""
        self.fence.note(self.door, error, peer)
        return f"{type(error).__name__}: {_named(error)}"


def _named(what: object) -> str:
    """Return the name of a peer, or the text of an exception, whatever its own code does."""
    try:
        return str(what)[:LETTERS]
    except Exception:
        return type(what).__name__


def _way(trace: TracebackType | None) -> list[str]:
    """Return file, line and function of each step to an exception, the outermost first."""
    way = []
    while trace is not None:
        code = trace.tb_frame.f_code
        way.append(f"{Path(code.co_filename).name}:{trace.tb_lineno} {code.co_name}")
        trace = trace.tb_next
    return way
