"""Sockets of this machine that a process listens at by a path, and the process at their other end.

Where there are no unix sockets (Windows), one of 127.0.0.1 stands for them: the file at the path has its port and a
token, and a client says the token first. A user who can read that file can connect; on Windows its folder says who can.
"""

from __future__ import annotations

import os
import secrets
import select
import socket
import stat
import struct
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.host.process import NOBODY, user
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    import asyncio

#: Process, user and group at the other end (unix(7), SO_PEERCRED).
_CREDENTIALS = struct.Struct("3i")
#: All groups of the process at the other end (socket(7) of Linux 4.13); Python's module has no name for it.
_SO_PEERGROUPS, _MOST_GROUPS = 59, 1024
#: Whether there is SocketCAN, and with it what a pump needs of Linux' C library.
CAN = hasattr(socket, "AF_CAN")
#: Whether a path can be that of a socket here.
_UNIX = hasattr(socket, "AF_UNIX")
#: Letters of a token, and how long a client that has connected may take to say it [s].
_TOKEN, _PATIENCE_S = 32, 0.02


def reuse(made: socket.socket) -> None:
    """Let a socket that is to listen have an address of which connections are still ending, but no listener."""
    if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):  # Windows: by SO_REUSEADDR two would listen
        made.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
    else:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)


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
    try:
        made = _unix(path, kind, mode) if _UNIX else _Tokened(path)
    except OSError as error:
        raise InputError(f"no {what} can be made here: {error.strerror or error}", value=str(path)) from error
    made.listen(16)
    made.setblocking(False)
    return made


def _unix(path: Path, kind: int, mode: int) -> socket.socket:
    made = socket.socket(socket.AF_UNIX, kind)
    before = os.umask(0o777 & ~mode)
    try:
        made.bind(str(path))
    except OSError:
        made.close()
        raise
    finally:
        os.umask(before)
    return made


class _Tokened(socket.socket):
    """A socket of 127.0.0.1 that takes clients that can read the file at a path."""

    def __init__(self, path: Path) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_STREAM)
        self.bind(("127.0.0.1", 0))
        self._token = secrets.token_hex(_TOKEN // 2)
        try:
            # The file is its owner's before anything is in it.
            with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
                file.write(f"127.0.0.1 {self.getsockname()[1]} {self._token}\n")
        except OSError:
            self.close()
            raise

    def accept(self) -> tuple[socket.socket, object]:
        """Take a connection that says the token.

        Raises:
            BlockingIOError: there is none.
        """
        made, peer = super().accept()
        said = b""
        while len(said) < _TOKEN:
            ready = select.select([made], [], [], _PATIENCE_S)[0]
            data = made.recv(_TOKEN - len(said)) if ready else b""
            if not data:
                break
            said += data
        if not secrets.compare_digest(said, self._token.encode()):
            made.close()
            raise BlockingIOError("the client has not said the token")
        return made, peer


def _place(path: Path) -> tuple[str, int, bytes]:
    """Return host, port and token that a file names.

    Raises:
        OSError: there is no such file, or it names none.
    """
    try:
        host, port, token = path.read_text(encoding="ascii").split()
        return host, int(port), token.encode()
    except ValueError as error:
        raise OSError(f"{path} is no socket") from error


def connect(path: Path, *, kind: int = socket.SOCK_STREAM, patience_s: float | None = None) -> socket.socket:
    """Return a socket that is connected to the process that listens at a path.

    Args:
        path: of the socket.
        kind: of socket.
        patience_s: how long anything with it may take [s]; 0: it does not wait; None: it waits for ever.

    Raises:
        OSError: nobody listens there.
    """
    made = socket.socket(socket.AF_UNIX if _UNIX else socket.AF_INET, kind)
    made.settimeout(patience_s if _UNIX else patience_s or 1.0)
    try:
        if _UNIX:
            made.connect(str(path))
        else:
            host, port, token = _place(path)
            made.connect((host, port))
            made.sendall(token)
            made.settimeout(patience_s)
    except OSError:
        made.close()
        raise
    return made


async def open_connection(path: Path) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connect to the process that listens at a path.

    Raises:
        OSError: nobody listens there.
    """
    import asyncio  # noqa: PLC0415 - the daemon has none

    if _UNIX:
        return await asyncio.open_unix_connection(str(path))
    host, port, token = _place(path)
    reader, writer = await asyncio.open_connection(host, port)
    writer.write(token)
    return reader, writer


def _tidy(path: Path, what: str, listening: int) -> None:
    try:
        kind = path.lstat().st_mode
        if not (stat.S_ISSOCK(kind) if _UNIX else _place(path)):
            raise OSError("no socket")
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"this is no socket; the {what} does not replace it", value=str(path)) from error
    try:
        with closing(connect(path, kind=listening, patience_s=0)):
            pass
    except ConnectionRefusedError:
        path.unlink(missing_ok=True)  # of a process that was killed
        return
    except OSError as error:
        raise InputError(f"the {what}: {error.strerror or error}", value=str(path)) from error
    raise InputError(f"another gateway listens at this {what}", value=str(path))


def remove(path: Path, inode: int) -> None:
    """Remove the file of a socket, unless it has been removed already or is that of another process now."""
    try:
        if path.stat().st_ino == inode:
            path.unlink()
    except OSError:
        return


def credentials_of(connection: socket.socket) -> tuple[int, int, int]:
    """Return process, user and group at the other end; NOBODY where the system does not tell.

    One that has said the token is of this process's user.
    """
    if not _UNIX:
        return NOBODY, user(), NOBODY
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
