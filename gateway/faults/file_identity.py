"""The place of the fault memory's file: whether the file there is the one that its writer opened, as he left it.

It is another one if it was deleted or replaced (device and inode), and not as the writer left it if another process has
written into it or into its log (:mod:`gateway.faults.tamper_check`).
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from gateway.faults import chain
from gateway.faults.tamper_check import TamperCheck

#: Stands for the device and the inode of a file that is not there.
NO_FILE = (0, 0)


class Place:
    """Where the file of an open database is.

    Attributes:
        overwritten: changes in place of the file, of its log; each "" if it is as it was.
        log: device and inode of the log.
    """

    def __init__(self) -> None:
        self.overwritten: tuple[str, str] = ("", "")
        self._inode = self.log = NO_FILE
        self._watched: TamperCheck | None = None

    def begin(self, path: Path) -> None:
        """Watch the file and the log that are there now; they were just opened."""
        self._inode, self.log = _inode(path), _inode(_log(path))
        with suppress(OSError):
            self._watched = TamperCheck(path)

    def end(self) -> None:
        """Watch no more, after the connection was closed."""
        if self._watched is not None:
            self._watched.close()
            self._watched = None

    @property
    def watched(self) -> bool:
        """Whether the file's content is watched."""
        return self._watched is not None

    def is_in_place(self, path: Path) -> bool:
        """Return whether the file there is the one that was opened."""
        return _inode(path) == self._inode

    def is_taken(self, path: Path) -> bool:
        """Return whether another file has the place of one that was opened here before."""
        return self._inode != NO_FILE and not self.is_in_place(path)

    def has_own_log(self, path: Path) -> bool:
        """Return whether the log there is that of the file that was opened."""
        return _inode(_log(path)) == self.log

    @property
    def is_same(self) -> bool:
        """Whether it is certain that no other process has touched the file or its log."""
        return self._watched is not None and self._watched.is_same()

    @property
    def doubtful(self) -> bool:
        """Whether another process has touched the file or its log: :meth:`examine` says more."""
        return self._watched is not None and not self._watched.is_same()

    @property
    def file_is_doubtful(self) -> bool:
        """Whether another process has touched the file."""
        return self._watched is not None and not self._watched.file_is_same()

    @property
    def log_is_same(self) -> bool:
        """Whether no other process has touched the log."""
        return self._watched is not None and self._watched.log_is_same()

    def examine(self, head: chain.Head) -> bool:
        """Look thoroughly; returns whether all is as it was written.

        Args:
            head: the last link that was written.
        """
        if self._watched is not None:
            self.overwritten = self._watched.what_changed(head)
        return not any(self.overwritten)

    @property
    def what_changed(self) -> str:
        """The error of the file, in a few words."""
        return " and ".join(filter(None, self.overwritten)) or "the file is not there any more"

    def note_commit(self) -> None:
        """Note what a commit of the writer left."""
        if self._watched is not None:
            self._watched.note_log()

    def note_checkpoint(self) -> None:
        """Note what a checkpoint of the writer left."""
        if self._watched is not None:
            self._watched.note_log()
            with suppress(OSError):
                self._watched.note_file()

    def keep_from_copying(self) -> None:
        """Have the connection closed without a checkpoint, if the file or its log was changed in place."""
        if self._watched is not None and any(self.overwritten):
            self._watched.keep_from_copying()


def _inode(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:
        return NO_FILE
    return found.st_dev, found.st_ino


def _log(path: Path) -> Path:
    return Path(f"{path.resolve()}-wal")
