"""The journal's file beside the fault memory: verdicts that were told before the memory's own file had them.

It matters only where a process ends, or the power goes, in the moment between the two. It has :data:`SLOTS` records of
fixed size, each in a sector of its own: a write that is torn harms no other. A record has the digest of the last link
of the chain (:mod:`gateway.faults.chain`) that the memory's file had then, and no write was under way. So each later
commit has the verdict in it, or came from another process, and the record counts only as long as that link is the last
one. A record ends with the commit that makes it superfluous; it still says that the file had this link
(:mod:`gateway.faults.rollback`). Records of another generation of the file are of no use, and go at the next start.

==========  =============================================================================
byte        content (little endian)
==========  =============================================================================
0 to 7      :data:`MAGIC`
8 to 15     number of the verdict, from 1
16 to 47    digest of the last link
48 to 63    the fault: first half of the SHA-256 of its id, because places change
64 to 71    time of the wall clock [ns]
72 to 75    1 failed or 2 passed; status byte after it; failures; fault detection counter
80 to 87    number of the last link
88 to 95    generation of the memory's file
96 to 103   CRC-32 of all before
==========  =============================================================================

Records of earlier versions (``GWVERD1``) end at byte 80, with their CRC. From byte 256 on stands the last link of a
commit that came since, written into the place that the next verdict overwrites, and put on the disk with that.
"""

from __future__ import annotations

import hashlib
import os
import stat
import struct
import zlib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from gateway.faults.records import Record
from gateway.faults.rollback import LastLink, packed, unpacked
from gateway.host.process import RAW

SUFFIX = "-verdicts"
SLOTS, SLOT, LINK_AT = 32, 512, 256
LENGTH = SLOTS * SLOT
MAGIC = int.from_bytes(b"GWVERD2\0", "little")
_EARLIER = int.from_bytes(b"GWVERD1\0", "little")
_CONTENT, _SUM = struct.Struct("<QQ32s16sqBBBb4xqq"), struct.Struct("<Q")
_FORMATS = {MAGIC: _CONTENT, _EARLIER: struct.Struct("<QQ32s16sqBBBb4x")}
#: Bytes of a record.
RECORD = _CONTENT.size + _SUM.size
#: A greater number is no verdict's.
_MOST = 1 << 62
_SAFELY = RAW | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


class LastVerdict(NamedTuple):
    """A record of the journal; ``fault`` as of :func:`name_of`, ``kind`` that of an event; 0: no link is named."""

    number: int
    head: bytes
    fault: bytes
    t_ns: int
    kind: int
    status: int
    occurrence: int
    fdc: int
    link: int = 0
    generation: int = 0


def path_of(database: Path) -> Path:
    """Return where the journal of a fault memory is; links to it share one."""
    return Path(f"{database.resolve()}{SUFFIX}")


def name_of(fault: str) -> bytes:
    """Return what stands for a fault's id, 16 bytes."""
    return hashlib.sha256(fault.encode()).digest()[:16]


def records(content: bytes) -> list[LastVerdict]:
    """Return the whole records of a journal, in order; what is garbage is none."""
    found = []
    for at in range(0, len(content) - RECORD + 1, SLOT):
        form = _FORMATS.get(int.from_bytes(content[at : at + 8], "little"))
        if form is None:
            continue
        part = content[at : at + form.size]
        record = LastVerdict(*form.unpack(part)[1:])
        whole = _SUM.unpack_from(content, at + form.size)[0] == zlib.crc32(part)
        if whole and 0 < record.number < _MOST:
            found.append(record)
    return sorted(found)


def _open(database: Path, flags: int) -> int:
    """Open the journal of a fault memory.

    Raises:
        OSError: it cannot be, or it is another user's, or no file: who may write it can report any fault.
    """
    file = os.open(path_of(database), flags | _SAFELY)
    try:
        found = os.fstat(file)
        if not stat.S_ISREG(found.st_mode):
            raise OSError("it is no file")
        if found.st_uid != database.stat().st_uid:
            raise OSError("it belongs to another user than the fault memory")
    except OSError:
        os.close(file)
        raise
    return file


def _make(database: Path) -> None:
    """Make the journal, if it is not there, with the database's owner and mode, as SQLite makes its log.

    Raises:
        OSError: it cannot be made.
    """
    like = database.stat()
    try:
        file = os.open(path_of(database), os.O_WRONLY | os.O_CREAT | os.O_EXCL | _SAFELY, 0o600)
    except FileExistsError:
        return
    try:
        if like.st_uid != os.fstat(file).st_uid:
            os.fchown(file, like.st_uid, like.st_gid)
        os.fchmod(file, stat.S_IMODE(like.st_mode))
    finally:
        os.close(file)


def _read(database: Path) -> bytes:
    """Return the journal of a fault memory; b"", if it cannot be read."""
    try:
        file = _open(database, os.O_RDONLY)
        try:
            return os.read(file, LENGTH)
        finally:
            os.close(file)
    except OSError:
        return b""


def waiting(database: Path, head: bytes, generation: int = 0) -> list[LastVerdict]:
    """Return the verdicts that were told, and that a fault memory does not have, in order.

    Args:
        database: its file.
        head: digest of the last link of its chain.
        generation: of the file.
    """
    return [
        record for record in records(_read(database)) if record.head == head and record.generation in (0, generation)
    ]


def links(content: bytes) -> list[LastLink]:
    """Return the last links that a journal knows: that its verdicts came after, and of later commits."""
    noted = [unpacked(content[at + LINK_AT : at + SLOT]) for at in range(0, len(content), SLOT)]
    return [
        *(LastLink(record.generation, record.link, record.head) for record in records(content) if record.link),
        *(link for link in noted if link is not None),
    ]


def links_beside(database: Path) -> list[LastLink]:
    """Return the last links that the journal of a fault memory knows (see :func:`links`)."""
    return links(_read(database))


def note(file: int, number: int, link: LastLink) -> None:
    """Note the last link of a commit, which is on the disk.

    Args:
        file: descriptor of the journal.
        number: of the next verdict.
        link: of the memory's file.
    """
    with suppress(OSError):
        os.pwrite(file, packed(link), number % SLOTS * SLOT + LINK_AT)


def show(verdicts: Iterable[LastVerdict], records: Iterable[Record]) -> None:
    """Have records show verdicts that wait, for a reader: what was told of them, without what was seen."""
    known = {name_of(record.id): record for record in records}
    for verdict in verdicts:
        record = known.get(verdict.fault)
        if record is None:
            continue
        record.status = verdict.status
        if record.occurrence != verdict.occurrence:
            record.occurrence, record.last_ns, record.evidence = verdict.occurrence, verdict.t_ns, {}
            record.first_ns = verdict.t_ns if record.first_ns is None else record.first_ns


def begin(database: Path, generation: int = 0) -> tuple[int, int]:
    """Have a journal whose blocks are all there, so that a record needs no new one; its records stay.

    Args:
        database: the fault memory's file.
        generation: of that file: records of another one go.

    Returns:
        its descriptor; the number of its latest record, 0: there is none.

    Raises:
        OSError: there is none, and none can be made: :func:`_open` says more.
    """
    _make(database)
    file = _open(database, os.O_RDWR)
    try:
        content = os.pread(file, LENGTH, 0).ljust(LENGTH, b"\0")
        latest = max((record.number for record in records(content)), default=0)
        content = b"".join(
            bytes(SLOT) if any(link.generation != generation for link in links(slot)) else slot
            for slot in (content[at : at + SLOT] for at in range(0, LENGTH, SLOT))
        )
        os.ftruncate(file, LENGTH)
        os.pwrite(file, content, 0)
        os.fsync(file)
        folder = os.open(path_of(database).parent, os.O_RDONLY | RAW)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError:
        os.close(file)
        raise
    return file, latest
