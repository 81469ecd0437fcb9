"""Rules that no frame, or too few, ever passed: rules that fit instead are looked for beside the loop, and told."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from gateway.engine.checks.communication import CheckInstance
from gateway.engine.core import Engine
from gateway.runtime.rule_candidates import differing, fitting, fitting_modes
from gateway.signals.database import Database
from gateway.signals.protection.params import protection_for
from gateway_fdi.common.log import get_logger

_log = get_logger(__name__)


class FailingRules:
    """Finds rules that fit, for checks that no frame passes.

    Args:
        engine: keeps frames that did not pass.
        checks: in the engine's order.
        databases: of each bus.
        names: of the buses.
        report: takes the event.
    """

    def __init__(
        self,
        engine: Engine,
        checks: Sequence[CheckInstance],
        databases: Sequence[Database],
        names: Sequence[str],
        report: Callable[[dict[str, Any]], None],
    ) -> None:
        self._engine, self._checks, self._databases = engine, checks, databases
        self._names, self._report = names, report
        self._thread: ThreadPoolExecutor | None = None
        self._sought: list[Future[dict[str, Any]]] = []

    def seek_beside(self) -> None:
        """Look for rules in a thread from now on: the loop has no time for it."""
        self._thread = ThreadPoolExecutor(1, "rules")

    def seek(self, fault: int, t_ns: int) -> None:
        """Look for rules that fit, if a fault is of a doubted one; tells them at once, or by :meth:`poll`."""
        found = self._engine.misfits(fault)
        if found is None:
            return
        index, payloads = found
        if self._thread is None:
            self._report_rule(self._event(index, payloads, t_ns))
        else:
            self._sought.append(self._thread.submit(self._event, index, payloads, t_ns))

    @property
    def busy(self) -> bool:
        """Whether rules are looked for."""
        return bool(self._sought)

    def poll(self) -> None:
        """Tell what has been found since."""
        if self._sought:
            done = [each for each in self._sought if each.done()]
            self._sought = [each for each in self._sought if not each.done()]
            for each in done:
                self._report_rule(each.result())

    def succeed(self, old: FailingRules) -> None:
        """Go on with the thread of the gateway before, and its search."""
        self._thread, self._sought = old._thread, old._sought

    def close(self) -> None:
        """End the thread."""
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)

    def _event(self, index: int, payloads: Sequence[bytes], t_ns: int) -> dict[str, Any]:
        check = self._checks[index]
        message = self._databases[check.bus].message(check.params.message)
        asked, e2e = protection_for(message, check.params), check.params.e2e
        modes = [] if e2e is None else fitting_modes(message, e2e, payloads)
        return {
            "event": "protection",
            "t_ns": t_ns,
            "bus": self._names[check.bus],
            "message": message.name,
            "rule": asked.name,
            "fits": [] if asked.freshness is not None else [*modes, *fitting(message, asked.field, payloads)],
            "differs": differing(asked, payloads),
        }

    def _report_rule(self, event: dict[str, Any]) -> None:
        of = {"bus": event["bus"], "message": event["message"], "configured": event["rule"]}
        if event["differs"]:
            text = "the checksum of every frame is right, but its header is not the one configured"
            _log.warning(text, **of, differs=", ".join(event["differs"]))
        else:
            fits = ", ".join(event["fits"]) or "none that the gateway knows"
            text = "no frame, or too few, ever passed the checksum: the rule is likely another one"
            _log.warning(text, **of, fits=fits)
        self._report(event)
