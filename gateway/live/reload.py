"""A changed configuration, read and prepared beside the running gateway."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.config.model import Config
from gateway.live.machine import Thread, begin_thread
from gateway.runtime.assemble import Parts
from gateway_fdi.errors import GatewayError


@dataclass(frozen=True)
class Prepared:
    """A configuration that is right, and the objects built from it."""

    config: Config
    parts: Parts


class Reloader:
    """Prepares configurations in a thread, one at a time.

    Args:
        prepare: reads and builds; its errors are those of the configuration.
        begin_thread: begins a thread: its work and its name.
    """

    def __init__(
        self,
        prepare: Callable[[], Prepared],
        begin_thread: Callable[[Callable[[], None], str], Thread] = begin_thread,
    ) -> None:
        self._prepare, self._begin_thread = prepare, begin_thread
        self._requested = False
        self._thread: Thread | None = None
        self._result: Prepared | GatewayError | None = None

    def request(self, *_: object) -> None:
        """Ask for the configuration to be read again; may be a signal handler."""
        self._requested = True

    def begin(self) -> bool:
        """Begin what was asked for, unless the last time is not over; returns whether it began."""
        if not self._requested or self._thread is not None:
            return False
        self._requested = False
        self._thread = self._begin_thread(self._work, "reload")
        return True

    def take(self) -> Prepared | GatewayError | None:
        """Return what was prepared, or what is wrong with it, once; None: nothing yet."""
        if self._thread is None or self._thread.is_alive():
            return None
        self._thread.join()
        self._thread = None
        result, self._result = self._result, None
        return result

    def _work(self) -> None:
        try:
            self._result = self._prepare()
        except GatewayError as error:
            self._result = error
        except Exception as error:  # after any error the old configuration goes on
            self._result = GatewayError(f"{type(error).__name__}: {error}")
