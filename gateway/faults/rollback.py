"""Whether a fault memory's file went back to an earlier state: an attack, a backup put back, a log that was lost.

SQLite cannot know: a file whose log (-wal) is gone, or ends early, is a whole one of before. So its last link is known
in two other files: the journal has it with each verdict, the lock has it after each commit. Both are written when that
link is on the disk. So a file that does not have it is older, whatever was lost at a power cut. A generation, a number
that no other file has, stands with the link: a file that was put there from elsewhere shows, however long its chain is.

All files of an earlier time, put back together, cannot be told from that time.
"""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections.abc import Iterable
from typing import NamedTuple

_MAGIC, _CONTENT, _SUM = b"GWLINK1\0", struct.Struct("<8sqq32s"), struct.Struct("<I")
#: Bytes of a link beside the file.
LINK = _CONTENT.size + _SUM.size


class LastLink(NamedTuple):
    """A link of the chain that was the last one, and on the disk.

    Attributes:
        generation: of the file.
        number: of the link; 0: none, the file is expected to be begun.
        digest: of the link.
    """

    generation: int
    number: int
    digest: bytes


def packed(link: LastLink) -> bytes:
    """Return a link as it stands beside the file: magic, generation, number, digest, CRC-32; little endian."""
    content = _CONTENT.pack(_MAGIC, *link)
    return content + _SUM.pack(zlib.crc32(content))


def unpacked(content: bytes) -> LastLink | None:
    """Return the link that :func:`packed` made these bytes of; None: there is none, or it is torn."""
    part = content[: _CONTENT.size]
    if not part.startswith(_MAGIC) or content[_CONTENT.size : LINK] != _SUM.pack(zlib.crc32(part)):
        return None
    return LastLink(*_CONTENT.unpack(part)[1:])


def generation_of(db: sqlite3.Connection) -> int:
    """Return a file's generation; 0: it has none.

    Raises:
        sqlite3.Error: it cannot be read.
    """
    if db.execute("SELECT 1 FROM sqlite_schema WHERE name = 'generation'").fetchone() is None:
        return 0
    found = db.execute("SELECT id FROM generation").fetchone()
    return found[0] if found is not None and isinstance(found[0], int) else 0


def what_is_missing(db: sqlite3.Connection, known: Iterable[LastLink]) -> str:
    """Return what a file does not have though it was on the disk, in a few words; "": nothing.

    Args:
        db: the file, which has a chain.
        known: last links that others know; they were read before the file is.

    Raises:
        sqlite3.Error: it cannot be read.
    """
    links = list(known)
    if not any(link.number for link in links):
        return ""
    generation = generation_of(db)
    own = [link for link in links if link.generation == generation]
    if not own:
        return "it is not the file that was kept here last: another one, or a backup of an earlier one, was put there"
    first, last = db.execute("SELECT min(number), max(number) FROM link").fetchone()
    newest = max(own, key=lambda link: link.number)
    if newest.number > (last or 0):
        return (
            f"it is older than what was kept here: links {(last or 0) + 1} to {newest.number} are missing, because its"
            " log (-wal) was lost or a backup was put back"
        )
    for link in own:
        found = db.execute("SELECT digest FROM link WHERE number = ?", (link.number,)).fetchone()
        if link.number >= (first or 0) and link.number and (found is None or found[0] != link.digest):
            return f"it is not what was kept here: link {link.number} is another one, so a backup went on elsewhere"
    return ""
