"""Errors as a user sees them: one line each; for an error of the gateway itself also where to report it."""

from __future__ import annotations

import errno
import os
import re
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from types import TracebackType
from typing import Any

import typer

from gateway import __version__
from gateway.common.extras import extra_with
from gateway_fdi.errors import GatewayError, InputError, InputErrors, nearest

#: Variable of the environment that asks for tracebacks.
DEBUG = "GATEWAY_DEBUG"
#: Name of the package in its metadata, and the links there that lead to its authors, the best first.
PACKAGE, LINKS = "ecu-gateway", ("issues", "bug tracker", "repository", "source", "homepage")

#: Exit code of what the user can mend, of Ctrl-C, and of an error of the gateway itself (EX_SOFTWARE of sysexits.h).
REFUSED, STOPPED, BUG = 2, 130, 70
#: Refusals of a write.
_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
#: An error of the system as Python writes it, with its number and its files.
_NUMBERED = re.compile(r"\[Errno \d+\] ([^:;]+)(?:: '[^']*'(?: -> '[^']*')?)?")
#: Options whose files are only read.
_READ = {"--config", "--ecu", "--key", "--ca", "--cert", "--certificate"}
_FULL = "free the disk, or name another place"
_PART = "a part of this path is a file"
#: Refusal of the system -> the way on.
_WAYS = {
    errno.ENOSPC: _FULL,
    errno.EDQUOT: _FULL,
    errno.EFBIG: _FULL,
    errno.EROFS: "name another place",
    errno.EACCES: "change its rights (ls -l), or name another file",
    errno.EPERM: "change its rights (ls -l), or name another file",
    errno.EISDIR: "name a file in it",
    errno.ENOTDIR: _PART,
    errno.EEXIST: _PART,
    errno.EIO: "the disk or device does not answer: copy the file to another one",
}

_ROOT = Path(__file__).parents[2]


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


def asked_for(error: InputError | InputErrors | OSError, given: Mapping[str, Any]) -> InputError | InputErrors:
    """Return an error with the option that its file came by, and the way on where the system refused it.

    Args:
        error: it.
        given: option or argument, as it is written -> value.
    """
    if isinstance(error, InputErrors):
        return InputErrors([_asked_for(one, given) for one in error.errors])
    return _asked_for(error, given)


def _asked_for(error: InputError | OSError, given: Mapping[str, Any]) -> InputError:
    if isinstance(error, OSError):
        copies = error.args[0] if error.args and isinstance(error.args[0], list) else []  # of shutil: from, to, why
        text, file = (copies[0][2], copies[0][1]) if copies else (error.strerror or str(error), error.filename)
        made = InputError(text, file=file)
        made.__cause__ = error
    else:
        made = error
    options = {key: value for key, value in given.items() if key.startswith("--")}
    refused = made.__cause__ if isinstance(made.__cause__, OSError) else None
    if isinstance(error, OSError) and made.file is None:  # of a read or a write that does not say whose
        written = {key: value for key, value in options.items() if isinstance(value, Path) and key not in _READ}
        asked = written if error.errno in _NO_ROOM else {key: given[key] for key in given if key not in written}
        files = [each for value in asked.values() for each in _paths(value) if Path(each).exists()]
        return made.replace(
            file=" or ".join(files) or None,
            key=" or ".join(written) if asked is written else None,
            message=_with_way(made, error),
        )
    if refused is None:
        return made
    made = made.replace(message=_NUMBERED.sub(r"\1", made.message))
    keys = [key for key, value in options.items() if made.file is not None and made.file in _paths(value)]
    return made.replace(key=made.key or next(iter(keys), None), message=_with_way(made, refused))


def _paths(value: Any) -> list[str]:
    return [str(one) for one in (value if isinstance(value, list | tuple) else [value]) if isinstance(one, str | Path)]


def _with_way(error: InputError, refused: OSError) -> str:
    """Return the words of an error of the system, with the way on; files of like names where one is not there."""
    way = "" if ";" in error.message else _WAYS.get(refused.errno or 0, "")
    if refused.errno == errno.ENOENT and error.file is not None and ";" not in error.message:
        path = Path(error.file)
        if not path.parent.is_dir():
            way = f"there is no folder {path.parent}"
        elif names := nearest(path.name, [each.name for each in path.parent.iterdir()]):
            way = names.removeprefix("; ")
    return f"{error.message}; {way}" if way else error.message


def ended_by(error: Exception) -> int:
    """Say what ended a command, and return its exit code."""
    if isinstance(error, GatewayError):
        refuse(str(error))
        return REFUSED
    if isinstance(error, OSError):  # a full disk, a folder that may not be written, ...
        refuse(str(asked_for(error, {})), error)
        return REFUSED
    if isinstance(error, ModuleNotFoundError) and (lacking := extra_with(error.name or "")):
        refuse(lacking, error)
        return REFUSED
    bug(error)
    return BUG


#: Words of a command that is stopped: its work so far, and how it goes on.
_so_far: list[Callable[[], str]] = []


def on_stop(so_far: Callable[[], str]) -> None:
    """Have Ctrl-C say what is done, and how to go on.

    Args:
        so_far: returns the line.
    """
    _so_far[:] = [so_far]


def stopped() -> int:
    """Say that Ctrl-C ended a command; returns the exit code."""
    told = _so_far[0]() if _so_far else "nothing more is written; the same command begins again"
    typer.echo(f"stopped: {told}", err=True)
    return STOPPED


def _place(trace: TracebackType | None) -> str:
    """Return the innermost place in the gateway's code."""
    frames = traceback.extract_tb(trace)
    found = [(_ours(frame.filename), frame) for frame in frames]
    found = [(name, frame) for name, frame in found if name] or [(Path(f.filename).name, f) for f in frames]
    return f" ({found[-1][0]}:{found[-1][1].lineno})" if found else ""


def _ours(filename: str) -> str:
    """Return the place of a file of our packages, from their folder on; "": it is none."""
    path = Path(filename)
    if not path.is_relative_to(_ROOT):
        return ""
    name = path.relative_to(_ROOT)
    package = name.parts[1] if name.parts[0] == "packages" else name.parts[0]
    return str(name) if package == "gateway" or package.startswith("gateway_") else ""


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
        elif failed.exc_value is not None and any(map(_ours, places)):
            bug(failed.exc_value)

    threading.excepthook = in_thread
    sys.unraisablehook = in_vain
