"""Errors as a user sees them: one line each; for an error of the gateway itself also where to report it."""

from __future__ import annotations

import os
import sys
import threading
import traceback
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from types import TracebackType
from typing import Any

import typer

from gateway import __version__
from gateway_fdi.errors import GatewayError

#: Variable of the environment that asks for tracebacks.
DEBUG = "GATEWAY_DEBUG"
#: Name of the package in its metadata, and the links there that lead to its authors, the best first.
PACKAGE, LINKS = "ecu-gateway", ("issues", "bug tracker", "repository", "source", "homepage")

#: Exit code of what the user can mend, and of an error of the gateway itself (EX_SOFTWARE of sysexits.h).
REFUSED, BUG = 2, 70

_OURS = str(Path(__file__).parent.parent)


def debugging() -> bool:
    """Return whether the user wants tracebacks."""
    return os.environ.get(DEBUG, "") not in ("", "0")


def report_to() -> str:
    """Return where errors of the gateway are to be reported, as far as its package says."""
    try:
        links = metadata(PACKAGE).get_all("Project-URL") or []
    except PackageNotFoundError:
        links = []
    found = {name.strip().lower(): url.strip() for name, _, url in (x.partition(",") for x in links)}
    return next((found[name] for name in LINKS if name in found), "where you have it from")


def refuse(text: str, error: BaseException | None = None) -> None:
    """Say what the user can mend."""
    if error is not None and debugging():
        traceback.print_exception(error)
    for line in text.splitlines():
        typer.secho(f"error: {line}", fg=typer.colors.RED, err=True)


def ended_by(error: Exception) -> int:
    """Say what ended a command, and return its exit code."""
    if isinstance(error, GatewayError):
        refuse(str(error))
        return REFUSED
    if isinstance(error, OSError):  # a full disk, a folder that may not be written, ...
        refuse(f"{error.filename}: {error.strerror}" if error.filename else str(error), error)
        return REFUSED
    bug(error)
    return BUG


def _place(trace: TracebackType | None) -> str:
    """Return the innermost place in the gateway's code."""
    frames = traceback.extract_tb(trace)
    ours = [frame for frame in frames if frame.filename.startswith(_OURS)] or list(frames)
    if not ours:
        return ""
    path = Path(ours[-1].filename)
    name = path.relative_to(Path(_OURS).parent) if str(path).startswith(_OURS) else path.name
    return f" ({name}:{ours[-1].lineno})"


def bug(error: BaseException) -> None:
    """Say in one line that this is an error of the gateway, and where to report it."""
    if debugging():
        traceback.print_exception(error)
    what = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    hint = "" if debugging() else f"; with its traceback: gateway --debug ..., or {DEBUG}=1"
    typer.secho(
        f"error: this is a bug of the gateway {__version__}, not of yours: {what}{_place(error.__traceback__)}."
        f" Please report it with what you did, {report_to()}{hint}",
        fg=typer.colors.RED,
        err=True,
    )


def install_hooks() -> None:
    """Say the same of what fails in a thread; leave out what a library fails at when it is put away."""

    def in_thread(failed: threading.ExceptHookArgs) -> None:
        if failed.exc_value is not None and not isinstance(failed.exc_value, SystemExit):
            bug(failed.exc_value)

    shown = sys.unraisablehook

    def in_vain(failed: Any) -> None:
        places = [frame.filename for frame in traceback.extract_tb(failed.exc_traceback)]
        if debugging():
            shown(failed)
        elif failed.exc_value is not None and any(place.startswith(_OURS) for place in places):
            bug(failed.exc_value)

    threading.excepthook = in_thread
    sys.unraisablehook = in_vain
