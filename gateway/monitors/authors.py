"""An author's mistake in what his monitor does in plain Python is told as his: with file and line."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from gateway.errors import GatewayError, InputError
from gateway.monitors.contract import Monitor


@contextmanager
def author_of(monitor: Monitor[Any], what: str) -> Iterator[None]:
    """Tell what fails inside as the author's mistake; of a monitor of ours it stays what it is.

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
