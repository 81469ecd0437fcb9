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

    @property
    def ready(self) -> bool:
        """Whether a configuration was prepared, or found to be wrong."""
        return self._thread is not None and not self._thread.is_alive()

    def take(self) -> Prepared:
        """Return what was prepared, once it is ready.

        Raises:
            GatewayError: the configuration is wrong.
        """
        assert self._thread is not None
        self._thread.join()
        self._thread = None
        result, self._result = self._result, None
        if not isinstance(result, Prepared):
            raise result or GatewayError("the thread that prepares it has ended")
        return result

    def _work(self) -> None:
        try:
            self._result = self._prepare()
        except GatewayError as error:
            self._result = error
        except Exception as error:  # after any error the old configuration goes on
            self._result = GatewayError(f"{type(error).__name__}: {error}")
