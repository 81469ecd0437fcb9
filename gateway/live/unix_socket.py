"""Sockets of this machine that a process listens at, for its owner alone."""

from __future__ import annotations

import os
import socket
import stat
from pathlib import Path

from gateway.errors import InputError


def listen_at(path: Path, what: str = "status socket") -> socket.socket:
    """Return a socket that listens at a path, for its owner alone; one that nobody listens at any more gives way.

    Args:
        path: of the socket.
        what: it is, for people.

    Raises:
        InputError: somebody does, or what is there is no socket.
    """
    _tidy(path, what)
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(0o177)
    try:
        made.bind(str(path))
    except OSError as error:
        made.close()
        raise InputError(f"no {what} can be made here: {error.strerror or error}", value=str(path)) from error
    finally:
        os.umask(before)
    made.listen(16)
    made.setblocking(False)
    return made


def _tidy(path: Path, what: str) -> None:
    try:
        kind = path.lstat().st_mode
    except OSError:
        return
    if not stat.S_ISSOCK(kind):
        raise InputError(f"this is no socket; the {what} does not replace it", value=str(path))
    probe = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    probe.setblocking(False)
    try:
        probe.connect(str(path))
    except ConnectionRefusedError:
        path.unlink(missing_ok=True)  # of a process that was killed
        return
    except OSError as error:
        raise InputError(f"the {what}: {error.strerror}", value=str(path)) from error
    finally:
        probe.close()
    raise InputError(f"another gateway listens at this {what}", value=str(path))
