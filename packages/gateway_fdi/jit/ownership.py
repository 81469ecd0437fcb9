"""Files that are code: only from this user, or from root, and where no other user can write.

A cache may lie in a folder that others share (``GATEWAY_CACHE_DIR=/tmp/x``). Code that another user wrote there would
run with this user's rights. Whose a file is says its descriptor, so that it cannot be exchanged after the look.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

#: A file is read as it is, and neither a link nor a pipe is waited for.
_READ = os.O_RDONLY
for _name in ("O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"):
    _READ |= getattr(os, _name, 0)
#: Modes by which others than the owner can write.
_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def _wrong_owner(status: os.stat_result) -> str:
    if hasattr(os, "geteuid") and status.st_uid not in (os.geteuid(), 0):
        return f"it belongs to another user ({status.st_uid})"
    return ""


def _wrong(status: os.stat_result) -> str:
    """Return why something may be another user's, "" if it is this user's.

    Windows numbers no users; there the folder's own rights decide, which the user's profile keeps from others.
    """
    if why := _wrong_owner(status):
        return why
    if hasattr(os, "geteuid") and status.st_mode & _OTHERS:
        return f"others can write it (mode {stat.S_IMODE(status.st_mode):o})"
    return ""


def foreign(folder: Path) -> str:
    """Return why a folder is not to be used, "" if it is this user's, or not there yet."""
    try:
        link = folder.lstat()
        if stat.S_ISLNK(link.st_mode) and (why := _wrong_owner(link)):
            return why
        status = folder.stat()
    except OSError:  # told by the code that reads or writes there
        return ""
    return _wrong(status) if stat.S_ISDIR(status.st_mode) else ""


def read_own(path: Path) -> bytes:
    """Return a file's bytes.

    Raises:
        OSError: it cannot be read.
        PermissionError: it is another's, or others can write it, or its folder.
    """
    if why := foreign(path.parent):
        raise PermissionError(errno.EPERM, why, str(path.parent))
    with os.fdopen(os.open(path, _READ), "rb") as file:
        status = os.fstat(file.fileno())
        why = _wrong(status) if stat.S_ISREG(status.st_mode) else "it is no file"
        if why:
            raise PermissionError(errno.EPERM, why, str(path))
        return file.read()


def write_own(path: Path, data: bytes) -> None:
    """Write a file that only this user can write, with any umask.

    Raises:
        OSError: it cannot be written.
    """
    path.write_bytes(data)
    path.chmod(0o644)
