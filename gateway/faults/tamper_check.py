"""Whether the fault memory's file, and its log, are as their only writer left them.

SQLite does not look. Its connection takes pages that it has read for granted as long as no other connection writes. So
it goes on writing into a file that was cut off, or that another one was copied over. Two looks find that out:

- A quick one at each commit: size and times of both files, and whether the index of the log is the same file. After
  each write of its own the writer sets the time of change back. So the next write leaves another time, however soon it
  comes (times of files go in steps of some ms).
- A thorough one, if the quick one finds a difference. The difference may be harmless: a backup that sets times, another
  link, a request of another process. The content of the file is compared with its checksum. A copy of file and log
  must have the last link of the chain (:mod:`gateway.faults.chain`): SQLite reads a log as far as its checksums go on.

The index of the log (-shm) is watched only for being there. Other processes make another one if it is gone. They do not
see then what is written, and write over it.

Only checkpoints change the file itself, and only the writer does these.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
import time
import zlib
from contextlib import closing, suppress
from pathlib import Path

from gateway.faults import chain
from gateway.faults.lock import keep_from_copying
from gateway.faults.salvage import FAST
from gateway.faults.schema import APPLICATION_ID, MAGIC
from gateway.host.process import RAW, read_at

#: Where the header has the application's id (https://www.sqlite.org/fileformat.html).
_APPLICATION = slice(68, 72)
#: How far the time of change is set back [ns]: more than the step of any file system's times.
_BACK_NS = 10_000_000_000
_CHUNK = 1 << 20

#: Device, inode, size, time of change of content and of all else.
_State = tuple[int, int, int, int, int]
_NO_FILE: _State = (0, 0, 0, 0, 0)


def _state(path: str) -> _State:
    try:
        found = os.stat(path)  # noqa: PTH116 - at each commit: a Path takes twice as long
    except OSError:
        return _NO_FILE
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _set_back(path: str) -> _State:
    """Set the time of change back; returns what the file is then."""
    with suppress(OSError):  # of another user's file: its own times have to do
        now_ns = time.time_ns()
        os.utime(path, ns=(now_ns, now_ns - _BACK_NS))
    return _state(path)


class TamperCheck:
    """The file of an open database in WAL mode, seen by its writer.

    Args:
        path: the file. Its connection must be open, and must be closed before this: a process that closes any
            descriptor of a file gives up its POSIX locks.

    Raises:
        OSError: it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        beside = path.resolve()  # SQLite keeps log and index beside the file itself, not beside a link to it
        self._path, self._wal, self._shm = str(path), f"{beside}-wal", f"{beside}-shm"
        self._file = os.open(path, os.O_RDONLY | RAW)
        self._file_state = self._log_state = _NO_FILE
        self._sum = 0
        self._index = _state(self._shm)[:2]
        try:
            self.note_file()
        except OSError:
            self.close()
            raise
        self.note_log()

    def close(self) -> None:
        """End it, after the connection."""
        os.close(self._file)

    def keep_from_copying(self) -> None:
        """Have the connection closed without a checkpoint: the file is not what its log belongs to."""
        keep_from_copying(self._file)

    def note_file(self) -> None:
        """Note what the file is after a checkpoint of its writer.

        Raises:
            OSError: it cannot be read.
        """
        self._file_state = _set_back(self._path)
        self._sum = self._checksum()

    def note_log(self) -> None:
        """Note what the log is after a commit of its writer."""
        self._log_state = _set_back(self._wal)

    def file_is_same(self) -> bool:
        """Return whether the file is untouched."""
        return _state(self._path) == self._file_state

    def log_is_same(self) -> bool:
        """Return whether the log is untouched."""
        return _state(self._wal) == self._log_state

    def index_is_same(self) -> bool:
        """Return whether the index of the log is the one that is open; SQLite mends its contents by itself."""
        return _state(self._shm)[:2] == self._index

    def is_same(self) -> bool:
        """Return whether all three are untouched: the quick look."""
        return self.file_is_same() and self.log_is_same() and self.index_is_same()

    def what_changed(self, head: chain.Head) -> tuple[str, str]:
        """Look thoroughly; returns what is wrong with the file, and with its log, each "" if it is as it was.

        Args:
            head: the last link that was written.
        """
        seen = _state(self._path), _state(self._wal)
        try:
            if seen[0] != self._file_state and self._checksum() != self._sum:
                return self._what_it_is(), ""
        except OSError as error:
            return f"it cannot be read: {error.strerror or error}", ""
        if not self.index_is_same():
            return "", "the index of its log (-shm) was deleted or replaced"
        if seen[1] != self._log_state:
            try:
                found = self._head_of_copy()
            except OSError:  # no room for the copy: it is looked at again
                return "", ""
            if found != head:
                return "", "its log (-wal) was changed in place"
        if (_state(self._path), _state(self._wal)) == seen:  # else it is looked at again
            self._file_state, self._log_state = _set_back(self._path), _set_back(self._wal)
        return "", ""

    def _checksum(self) -> int:
        found = at = 0
        while part := read_at(self._file, _CHUNK, at):
            found, at = zlib.crc32(part, found), at + len(part)
        return found

    def _what_it_is(self) -> str:
        head = read_at(self._file, 100, 0)
        size = os.fstat(self._file).st_size
        if size < self._file_state[2]:
            return f"it was cut off in place: {size} of {self._file_state[2]} bytes are left"
        if not head.startswith(MAGIC):
            return "it was overwritten in place: it is no SQLite file any more"
        if head[_APPLICATION] != APPLICATION_ID.to_bytes(4, "big"):
            return "another program's database was written over it"
        return "it was changed in place"

    def _head_of_copy(self) -> chain.Head:
        """Return the last link in file and log, as a reader finds it that opens them for the first time.

        Raises:
            OSError: there is no room for a copy.
        """
        try:
            return self._head_of_copy_in(FAST)
        except OSError:
            return self._head_of_copy_in(None)

    def _head_of_copy_in(self, place: Path | None) -> chain.Head:
        with tempfile.TemporaryDirectory(dir=place) as folder:
            copy = Path(folder) / "copy.sqlite"
            with copy.open("wb") as file:
                at = 0
                while part := read_at(self._file, _CHUNK, at):
                    at += file.write(part)
            with suppress(FileNotFoundError):
                shutil.copyfile(self._wal, f"{copy}-wal")
            try:
                with closing(sqlite3.connect(copy)) as db:
                    return chain.head(db)
            except sqlite3.Error:
                return chain.NO_HEAD
