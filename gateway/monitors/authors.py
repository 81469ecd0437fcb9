"""An author's mistake in his monitor's plain Python is told as his: with file and line."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from gateway_fdi.errors import GatewayError, InputError


class Written(Protocol):
    """Code of an author: a monitor."""

    @property
    def type(self) -> str:
        """Its name in the configuration."""

    @property
    def file(self) -> Path:
        """Where its kernel stands."""

    @property
    def outside(self) -> bool:
        """Whether it does not come with the gateway."""


@contextmanager
def author_of(monitor: Written, what: str) -> Iterator[None]:
    """Tell failures inside as the author's mistakes; those of a monitor of the gateway stay as they are.

    Args:
        monitor: whose code is run.
        what: which part of it, ``"prepare"``.

    Raises:
        InputError: it failed; with the line of the monitor's own code.
    """
    try:
        yield
    except GatewayError:
        raise
    except (Exception, SystemExit) as error:
        if not monitor.outside:
            raise
        places = [(frame.f_code.co_filename, line) for frame, line in traceback.walk_tb(error.__traceback__)]
        lines = [line for file, line in places if file == str(monitor.file)]
        line = lines[-1] if lines else None
        told = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        key = f'monitor type "{monitor.type}".{what}'
        raise InputError(f"fails: {' '.join(told.split())}", file=monitor.file, line=line, key=key) from error


def by_author(monitor: Written, what: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of an author's that tells what fails in it as his mistake (:func:`author_of`)."""

    def call(*arguments: Any) -> Any:
        with author_of(monitor, what):
            made = function(*arguments)
            return list(made) if isinstance(made, Iterator) else made  # a generator's failures are his, too

    return call
