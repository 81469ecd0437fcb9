"""A format of logs: its name, and what reads and writes it. Candump is the core's own; others come by a door."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gateway.bus.candump import CandumpWriter
from gateway.bus.frames import Frames
from gateway.bus.readers.batch import Reader
from gateway.bus.readers.candump import Candump
from gateway.common.extras import need
from gateway.common.plugins import Registry, accept_instance
from gateway_fdi.errors import InputError


class Sink(Protocol):
    """Writes a format; may have ``lost``, what the format cannot hold -> of how many frames."""

    def write(self, frames: Frames) -> None:
        """Append a batch."""

    def close(self) -> None:
        """Finish the file."""


@dataclass(frozen=True)
class LogFormat:
    """A format of logs.

    Attributes:
        name: for people.
        reader: of a path; it may have ``sniff`` (:class:`gateway.bus.readers.batch.Reader`).
        writer: of a path and the names of the buses, for formats that keep them.
        rank: where several formats know a log by its first bytes, the one of the lowest rank reads it.
        extra: that it needs, and for what; None: none.
    """

    name: str
    reader: Callable[[Path], Reader]
    writer: Callable[[Path, Mapping[int, str] | None], Sink]
    rank: int
    extra: tuple[str, str] | None = None

    def need(self, path: Path) -> None:
        """Refuse a log whose format needs what is not installed.

        Raises:
            InputError: it is not installed.
        """
        if self.extra is not None:
            need(*self.extra, file=path)


#: Suffix -> format, of packages above the core.
OTHERS: Registry[LogFormat] = Registry("gateway.formats", accept_instance(LogFormat))
CANDUMP = LogFormat("candump", Candump, lambda path, names: CandumpWriter(path.open("wb"), names), rank=100)


def formats() -> dict[str, LogFormat]:
    """Return all formats that can be used by their suffix, those first that know their logs best."""
    found = {}
    for suffix in OTHERS:
        with suppress(InputError):  # a log of this suffix has this error, and no other
            found[suffix] = OTHERS[suffix]
    found[".log"] = CANDUMP
    return dict(sorted(found.items(), key=lambda each: each[1].rank))
