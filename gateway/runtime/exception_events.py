"""Exceptions that the walls caught: told as security events at a bounded rate, and a code of the gateway's own.

They are looked for between two batches: what caught them may be in the middle of a request.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from gateway.common.fence import Fence
from gateway.engine.checks.own_health import EXCEPTIONS, OWNER, REPEATED, WINDOW_NS
from gateway.engine.core import Engine, Sink
from gateway.faults.status import NOT_COMPLETED, Status
from gateway.runtime.security import Security

#: Kinds of the security events, by wall.
KINDS = ("exception", "second_wall")
EXCEPTIONS_ID = f"{OWNER}.{EXCEPTIONS.name}"


class ExceptionEvents:
    """Tells what a fence caught.

    Args:
        fence: has it.
        engine: debounces the fault.
        security: takes the events.
        sink: takes the engine's events.
        status: byte of a fault in the fault memory: one that it has from before is tested in this cycle, too.
    """

    def __init__(
        self, fence: Fence, engine: Engine, security: Security, sink: Sink, status: Callable[[str], Status]
    ) -> None:
        self._fence, self._engine, self._security, self._sink = fence, engine, security, sink
        self._status = status
        ids = {slot.id: k for k, slot in enumerate(engine.faults)}
        self._place = ids.get(EXCEPTIONS_ID)
        self._times: deque[tuple[int, int, int]] = deque()  # when, how many, of these at the second wall
        self._failed = False

    def succeed(self, old: ExceptionEvents) -> None:
        """Go on where that of an earlier configuration stops."""
        self._times = old._times
        self._failed = old._failed

    def look(self) -> None:
        """Tell what is new, and report the fault where that is news."""
        now, news = self._engine.now_ns, self._fence.has_news
        if news:
            self._note(now)
        while self._times and now - self._times[0][0] > WINDOW_NS:
            self._times.popleft()
        if self._place is not None and self._engine.due_ns >= 0:
            self._report(self._place, news=news)

    def _note(self, now: int) -> None:
        total = second = 0
        for kind, caught in self._fence.take().items():
            context = {"exception": kind.exception, "place": kind.place, "peer": caught.peer}
            t_ns = self._engine.wall_ns(now)
            self._security.note(t_ns, kind.door, KINDS[kind.second], context, caught.count)
            total += caught.count
            second += caught.count * kind.second
        self._times.append((now, total, second))

    def _report(self, place: int, *, news: bool) -> None:
        """Report the gateway's own fault, if that is news, or the memory has it from before."""
        total, second = (sum(each[k] for each in self._times) for k in (1, 2))
        failed = total >= REPEATED
        due = (failed and news) or failed != self._failed
        if not due and self._engine.last_result(place) is None:
            due = bool(self._status(EXCEPTIONS_ID) & ~NOT_COMPLETED)
        if not due:
            return
        evidence = (float(total), float(second))
        if self._engine.report(place, failed, float(total), float(REPEATED), evidence, self._sink):
            self._failed = failed
