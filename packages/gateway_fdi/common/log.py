"""Log lines, by structlog. It is loaded with the first line, or by who cannot wait for it then.

structlog loads rich and asyncio, a third of a short command's time, and most commands have nothing to log. A bus in
operation calls :func:`load` before its first frame.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

#: Calls that set structlog up once it is loaded; empty when that is done, or not wanted.
_pending: list[Callable[[], None]] = []


class _Logger:
    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, method: str) -> Any:
        load()
        import structlog  # noqa: PLC0415 - slow to load

        return getattr(structlog.get_logger(self._name), method)


def get_logger(name: str) -> FilteringBoundLogger:
    """Return a logger with structlog's methods (info, warning, error, ...)."""
    return cast("FilteringBoundLogger", _Logger(name))


def load() -> None:
    """Load structlog, and set it up if :func:`to_stderr` was called; else it is as the program has it."""
    import structlog  # noqa: F401, PLC0415 - slow to load

    while _pending:
        _pending.pop()()


def to_stderr(level: int = logging.INFO) -> None:
    """Send log lines to stderr, from a level of :mod:`logging` on: readable on a terminal, JSON elsewhere."""
    _pending[:] = [partial(_configure, level)]


def reset() -> None:
    """Take :func:`to_stderr` back."""
    import structlog  # noqa: PLC0415 - slow to load

    _pending.clear()
    structlog.reset_defaults()


def _configure(level: int) -> None:
    import structlog  # noqa: PLC0415 - slow to load

    terminal = sys.stderr.isatty()
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            structlog.processors.format_exc_info,
            structlog.dev.ConsoleRenderer() if terminal else structlog.processors.JSONRenderer(),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=True,
    )
