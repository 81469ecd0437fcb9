"""Mishaps of the fault memory's file, to be told; a file found in its place is put aside with its date."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gateway.faults.salvage import Salvage, put_aside
from gateway.faults.store import DamagedError, ForeignError, OlderError, UnusableError


@dataclass(frozen=True)
class Incident:
    """Something that happened to the file, and the remedy.

    Attributes:
        kind: "damaged", "older", "deleted", "replaced", "overwritten", "foreign" or "unread".
        reason: in a few words.
        aside: where what was found is kept now; None: there was nothing, or it could not be put aside.
        recovered, lost: rows that were read of it, and that could not be.
    """

    kind: str
    reason: str
    aside: Path | None = None
    recovered: int = 0
    lost: int = 0


class StoreIncidents:
    """Puts wrong files aside, and keeps mishaps until they are told."""

    def __init__(self) -> None:
        self._found: list[Incident] = []

    def __bool__(self) -> bool:
        return bool(self._found)

    def take(self) -> list[Incident]:
        """Return what happened since the last call."""
        found, self._found = self._found, []
        return found

    def deleted(self) -> None:
        """Note that the file was deleted."""
        self._found.append(Incident("deleted", "its file was deleted"))

    def unread(self, path: Path) -> None:
        """Put aside a file that could not be read at the start.

        Raises:
            OSError: it cannot be put aside.
        """
        aside = put_aside(path, "unread")
        self._found.append(Incident("unread", "its file could not be read at the start", aside))

    def replaced(self, path: Path) -> None:
        """Put aside another file in the place of the own one.

        Raises:
            OSError: it cannot be put aside.
        """
        aside = put_aside(path, "replaced")
        self._found.append(Incident("replaced", "another file was put in its place", aside))

    def overwritten(self, path: Path, reason: str, kept: int, lost: int, *, apart: bool) -> None:
        """Put aside a file that was changed in place.

        Args:
            path: the file.
            reason: the part that was changed.
            kept: recordings that could be read of it.
            lost: those that could not be.
            apart: whether the log is not of what the file is now.

        Raises:
            OSError: it cannot be put aside.
        """
        aside = put_aside(path, "overwritten", apart=apart)
        self._found.append(Incident("overwritten", reason, aside, kept, lost))

    def foreign(self, path: Path, error: ForeignError) -> None:
        """Put another program's database aside.

        Raises:
            UnusableError: it cannot be.
        """
        try:
            aside = put_aside(path, "foreign")
        except OSError as problem:
            raise UnusableError(f"{error.message}, and it is not put aside: {problem}", file=path) from problem
        self._found.append(Incident("foreign", error.message, aside))

    def damaged(self, path: Path, error: DamagedError, found: Salvage) -> None:
        """Put a damaged file aside, or an older one, of which something could be read.

        Raises:
            UnusableError: it cannot be put aside.
        """
        kind = "older" if isinstance(error, OlderError) else "damaged"
        try:
            aside = put_aside(path, kind)
        except OSError as problem:
            raise UnusableError(f"{kind}, and not put aside: {problem}", file=path) from problem
        reason = error.message.partition(";")[0]
        self._found.append(Incident(kind, reason, aside, found.recovered, found.lost))
