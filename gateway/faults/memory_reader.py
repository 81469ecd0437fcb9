"""A fault memory that is read again and again beside its writer."""

from __future__ import annotations

from pathlib import Path

from gateway.faults import service
from gateway.faults.store import Store


class MemoryReader:
    """A fault memory, opened for reading when it is asked for.

    It stays open between two looks: to open it takes thousands of small pieces of memory, and between those that go
    with the connection lie those of what was read, so that the heap of the process would grow.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._store: Store | None = None
        self.inode = 0

    def store(self) -> Store:
        """Return it; another one, where a damaged file was put aside.

        Raises:
            GatewayError, OSError: it cannot be opened.
        """
        inode = self.path.stat().st_ino
        if self._store is None or inode != self.inode:
            self.close()
            self._store, self.inode = service.open_reader(self.path), inode
        return self._store

    def close(self) -> None:
        """Leave the file to its writer; a look opens it again."""
        store, self._store = self._store, None
        if store is not None:
            store.close()
