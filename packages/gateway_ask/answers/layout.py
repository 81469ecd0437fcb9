"""Layouts of answers from the files that people have: the door of this room."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gateway.signals.database import SUFFIXES
from gateway_ask.answers import databases, obdb, odx, wican
from gateway_ask.answers.j1979 import j1979, layouts_of_obd
from gateway_ask.answers.jsonfile import document_of
from gateway_ask.answers.model import Address, AnswerLayout, Layouts, LeftOut, Limits, layouts_for
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError

__all__ = [
    "Address",
    "AnswerLayout",
    "Layouts",
    "LeftOut",
    "Limits",
    "j1979",
    "layouts_for",
    "layouts_of_obd",
    "read_file",
    "read_layouts",
]

_log = get_logger(__name__)

#: Suffix -> reader: of the file and a model year.
_READERS: dict[str, Callable[[Path, int | None], Layouts]] = {
    **dict.fromkeys(SUFFIXES, databases.read),
    ".cdd": databases.read_cdd,
    ".json": lambda path, year: (obdb if "commands" in document_of(path) else wican).read(path, year),
    **dict.fromkeys((".odx", ".odx-d", ".pdx"), odx.read),
}


def read_file(path: Path, year: int | None = None) -> Layouts:
    """Read the layouts of a file, and what it has besides.

    Args:
        path: a database (DBC, KCD, SYM, ARXML: an extended identifier ``service << 16 | identifier`` a message), a CDD,
            ODX or PDX, a signal set of OBDb or a vehicle profile of WiCAN (JSON).
        year: model year, where a file distinguishes them; None: all, of two for one request the later.

    Raises:
        InputError: it cannot be read, or has no layouts; names file, line or key.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"layouts of answers are in files {', '.join(sorted(_READERS))}", file=path)
    return reader(path, year)


def read_layouts(path: Path, year: int | None = None) -> tuple[AnswerLayout, ...]:
    """Read the layouts of a file; a line of the log says how many of its parts have none.

    Args:
        path: as of :func:`read_file`.
        year: as there.

    Raises:
        InputError: as there.
    """
    found = read_file(path, year)
    if found.left_out:
        first = ": ".join(found.left_out[0])
        _log.warning("parts of the file have no layout", file=str(path), parts=len(found.left_out), first=first)
    return found.layouts
