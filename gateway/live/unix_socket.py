"""Sockets of this machine that a process listens at, and the process at their other end."""

from __future__ import annotations

import os
import socket
import stat
import struct
from pathlib import Path

from gateway_fdi.errors import InputError

#: Process, user and group at the other end (unix(7), SO_PEERCRED).
_CREDENTIALS = struct.Struct("3i")
#: All groups of the process at the other end (socket(7) of Linux 4.13); Python's module has no name for it.
_SO_PEERGROUPS, _MOST_GROUPS = 59, 1024
#: Asker whose user is unknown.
NOBODY = -1


def listen_at(
    path: Path, what: str = "status socket", *, kind: int = socket.SOCK_STREAM, mode: int = 0o600
) -> socket.socket:
    """Return a socket that listens at a path; one without a listener gives way.

    Args:
        path: of the socket.
        what: its name for people.
        kind: of socket.
        mode: of the file; as it is, it is for its owner alone.

    Raises:
        InputError: another process listens there, or the path is no socket.
    """
    _tidy(path, what, kind)
    made = socket.socket(socket.AF_UNIX, kind)
    before = os.umask(0o777 & ~mode)
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


def _tidy(path: Path, what: str, listening: int) -> None:
    try:
        kind = path.lstat().st_mode
    except OSError:
        return
    if not stat.S_ISSOCK(kind):
        raise InputError(f"this is no socket; the {what} does not replace it", value=str(path))
    probe = socket.socket(socket.AF_UNIX, listening)
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


def remove(path: Path, inode: int) -> None:
    """Remove the file of a socket, unless it has been removed already or is that of another process now."""
    try:
        if path.stat().st_ino == inode:
            path.unlink()
    except OSError:
        return


def credentials_of(connection: socket.socket) -> tuple[int, int, int]:
    """Return process, user and group at the other end; NOBODY on another system than Linux."""
    if not hasattr(socket, "SO_PEERCRED"):
        return NOBODY, NOBODY, NOBODY
    told = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, uid, gid = _CREDENTIALS.unpack(told)
    return pid, uid, gid


def groups_of(connection: socket.socket) -> set[int]:
    """Return the further groups of the process at the other end; none where the kernel does not tell them."""
    try:
        told = connection.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, 4 * _MOST_GROUPS)
    except OSError:
        return set()
    return {group for (group,) in struct.iter_unpack("I", told[: len(told) // 4 * 4])}
