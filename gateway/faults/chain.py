"""The chain of the fault memory: each change of the file is a link that holds the digest of the link before it.

A link names the subject that was written (a fault with its freeze frames and explanation, its recordings, an
intervention, an operation cycle, a permanent DTC, an identifier, a number), and has the digest of these rows. Its own
digest is over all that and over the digest of the link before. A clear is a link, too. So a row that another writer has
changed, added or taken away shows, and so does a link that is missing. The chain has no secret: every user who may
write the file can make all of it again. Then only the digest of the last link differs, which a running gateway knows,
and people can note.

A digest names the columns of the version that wrote its link: a column that a later version adds changes no digest that
is there, and is in those of later links.

Links are bounded: the oldest ones go, and their statements about rows that are still there are repeated at the end.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

from gateway.faults import rows, schema
from gateway.faults.records import Changes

#: Links that are kept; more where there are more rows.
MOST = 2000
#: Kinds of links that stand for rows, in the order of a file that is linked for the first time.
FAULT, RECORDINGS, CYCLE, PERMANENT = "fault", "recordings", "cycle", "permanent"
IDENTIFIER, NUMBER, INTERVENTION = "identifier", "number", "intervention"
#: Kinds that stand for no rows: the first link, a clear, all else that is written, and the rest of older links.
BEGIN, CLEAR, OTHER, ANCHOR = "begin", "clear", "other", "anchor"

#: Version of the links that say none: up to it each table had these columns. Digests are made of them in this order.
FIRST_VERSION = 8
_COLUMNS = {
    "fault": (
        "id", "dtc", "status", "failed_cycles", "occurrence", "first_ns", "last_ns", "evidence", "passed_cycles",
        "aged_cycles", "inputs", "peak_fdc", "near_misses", "first_failed", "last_failed", "first_confirmed",
        "last_confirmed",
    ),
    "freeze_frame": ("number", "t_ns", "content"),
    "cause": ("hold", "content"),
    "recording": ("fault", "t_ns", "frames", "dropped", "log"),
    "operation_cycle": ("name", "number", "open", "t_ns"),
    "permanent": ("fault", "dtc", "t_ns"),
    "identifier": ("did", "data"),
    "fact": ("name", "value"),
    "intervention": (
        "t_ns", "protocol", "bus", "address", "action", "request", "outcome", "session", "security", "role",
        "first_ns", "count", "number",
    ),
}  # fmt: skip
#: Table of a kind's rows, and which of them are those of a subject.
_ROWS = {
    FAULT: ("fault", "id = ?"),
    RECORDINGS: ("recording", "fault = ? ORDER BY id"),
    CYCLE: ("operation_cycle", "name = ?"),
    PERMANENT: ("permanent", "fault = ?"),
    IDENTIFIER: ("identifier", "did = CAST(? AS INTEGER)"),
    NUMBER: ("fact", "name = ?"),
    INTERVENTION: ("intervention", "number = CAST(? AS INTEGER)"),
}
#: Which subjects there are.
_SUBJECTS = {
    FAULT: "SELECT id FROM fault ORDER BY id",
    RECORDINGS: "SELECT DISTINCT fault FROM recording ORDER BY fault",
    CYCLE: "SELECT name FROM operation_cycle ORDER BY name",
    PERMANENT: "SELECT fault FROM permanent ORDER BY rowid",
    IDENTIFIER: "SELECT did FROM identifier ORDER BY did",
    NUMBER: "SELECT name FROM fact ORDER BY name",
    INTERVENTION: "SELECT number FROM intervention ORDER BY number",
}
_ADD = "INSERT INTO link (number, kind, subject, content, digest, version) VALUES (?, ?, ?, ?, ?, ?)"
_LINKS = "SELECT number, kind, subject, content, digest, version FROM link ORDER BY number"
#: Digest of rows that are not there.
GONE = b""


class Head(NamedTuple):
    """The last link: its number, and its digest."""

    number: int
    digest: bytes


NO_HEAD = Head(0, b"")


class Broken(NamedTuple):
    """A row that is not what the chain says.

    Attributes:
        kind, subject: of the row.
        link: number of the link that says so; 0: there is none.
        reason: in a few words.
    """

    kind: str
    subject: str
    link: int
    reason: str

    def __str__(self) -> str:
        where = f"link {self.link}" if self.link else "no link"
        return f"{f'{self.kind} {self.subject}'.strip()} ({where}): {self.reason}"


@dataclass
class Verdict:
    """The whole and the broken parts of a chain.

    Attributes:
        links: how many links were looked at.
        counted: rows that are as the chain says, by kind; clears that it has.
        broken: the others, the first one of the chain first.
        head: the last link.
    """

    links: int = 0
    counted: dict[str, int] = field(default_factory=dict)
    broken: list[Broken] = field(default_factory=list)
    head: Head = NO_HEAD


#: Made once: to make it takes longer than to use it.
_text_of = json.JSONEncoder(separators=(",", ":"), default=lambda value: {"hex": bytes(value).hex()}).encode


class _Version(NamedTuple):
    """Parts that digests of a version are made of.

    Attributes:
        selects: of the rows of each kind.
        frames, causes: of those that belong to a fault.
        order: places of its columns among those of :class:`gateway.faults.records.Record`; None: the same.
    """

    selects: dict[str, str]
    frames: str
    causes: str
    order: tuple[int, ...] | None


@cache
def _version(scripts: tuple[str, ...]) -> _Version:
    then, first = schema.columns_of(scripts), schema.columns_of(scripts[:FIRST_VERSION])
    named = {
        table: (*columns, *(name for name in then[table] if name not in first[table]))
        for table, columns in _COLUMNS.items()
    }
    selects = {
        kind: f"SELECT {', '.join(named[table])} FROM {table} WHERE {which}"  # noqa: S608 - our own names
        for kind, (table, which) in _ROWS.items()
    }
    frames, causes = (", ".join(named[table]) for table in ("freeze_frame", "cause"))
    known = named["fault"] != rows.COLUMNS and set(named["fault"]) <= set(rows.COLUMNS)
    return _Version(
        selects,
        f"SELECT {frames} FROM freeze_frame WHERE fault = ? ORDER BY number",  # noqa: S608
        f"SELECT 'cause', {causes} FROM cause WHERE fault = ?",  # noqa: S608
        tuple(map(rows.COLUMNS.index, named["fault"])) if known else None,
    )


def content(db: sqlite3.Connection, kind: str, subject: str, version: int) -> bytes:
    """Return the digest of the rows of a subject; :data:`GONE` if there are none.

    Args:
        db: the file.
        kind: of the rows.
        subject: of the rows.
        version: whose columns it names.

    Raises:
        sqlite3.Error: they cannot be read.
    """
    by = _version(schema.MIGRATIONS[:version])
    found: list[Any] = db.execute(by.selects[kind], (subject,)).fetchall()
    if not found:
        return GONE
    if kind == FAULT:
        found += db.execute(by.frames, (subject,)).fetchall()
        found += db.execute(by.causes, (subject,)).fetchall()  # none: the digest is that of earlier versions
    return _digest_of(found)


def _digest_of(found: list[Any]) -> bytes:
    return hashlib.sha256(_text_of(found).encode()).digest()


def _link_digest(before: bytes, number: int, kind: str, subject: str, content: bytes, version: int) -> bytes:
    name = f"{number}\0{kind}\0{len(subject)}\0{subject}"
    if version != FIRST_VERSION:
        name += f"\0{version}"
    return hashlib.sha256(before + name.encode() + content).digest()


def head(db: sqlite3.Connection) -> Head:
    """Return the last link.

    Raises:
        sqlite3.Error: it cannot be read.
    """
    row = db.execute("SELECT number, digest FROM link ORDER BY number DESC LIMIT 1").fetchone()
    return NO_HEAD if row is None else Head(*row)


def _append(db: sqlite3.Connection, links: Iterable[tuple[str, str, bytes, int]]) -> Head:
    """Append links of (kind, subject, content, version); returns the last one."""
    number, digest = head(db)
    made = []
    for kind, subject, of, version in links:
        number += 1
        digest = _link_digest(digest, number, kind, subject, of, version)
        made.append((number, kind, subject, of, digest, version))
    db.executemany(_ADD, made)
    return Head(number, digest)


def begin(db: sqlite3.Connection) -> None:
    """Begin the chain of a file with all that it has, within a transaction."""
    version = len(schema.MIGRATIONS)
    said = [(kind, subject, content(db, kind, subject, version), version) for kind, subject in _subjects(db)]
    _append(db, [(BEGIN, "", GONE, version), *said])


def _subjects(db: sqlite3.Connection) -> Iterator[tuple[str, str]]:
    for kind, select in _SUBJECTS.items():
        for (subject,) in db.execute(select).fetchall():
            yield kind, str(subject)


def write(db: sqlite3.Connection, changes: Changes) -> Head:
    """Write changes with their links, within a transaction; returns the last link.

    Raises:
        sqlite3.Error: they could not be written.
    """
    cleared = {record.id for record in changes.records if not record.occurrence}
    recorded = {recording.fault for recording in changes.recordings}
    if cleared:
        recorded |= cleared.intersection(fault for (fault,) in db.execute(_SUBJECTS[RECORDINGS]))
    permanent: set[str] = set()
    if changes.permanent is not None:
        permanent = {fault for (fault,) in db.execute(_SUBJECTS[PERMANENT])} | {p.fault for p in changes.permanent}
    written = rows.write(db, changes)
    touched = [
        *((FAULT, record.id) for record in changes.records),
        *((FAULT, fault) for fault in changes.statuses),
        *((RECORDINGS, fault) for fault in sorted(recorded)),
        *((CYCLE, name) for name in changes.cycles),
        *((PERMANENT, fault) for fault in sorted(permanent)),
        *((IDENTIFIER, str(did)) for did in changes.identifiers),
        *((NUMBER, name) for name in changes.facts),
        *((INTERVENTION, str(number)) for number in [*changes.interventions, *written.gone]),
    ]
    version = len(schema.MIGRATIONS)
    links = [(CLEAR, f"{group:06X}", GONE, version) for group in changes.cleared]
    # Of what each verdict changes the rows are known; to read them again would take as long as to write them.
    order = _version(schema.MIGRATIONS).order
    if order is not None:
        for found in written.records.values():
            found[0] = [found[0][place] for place in order]
    known: dict[tuple[str, str], list[Any]] = {(FAULT, fault): found for fault, found in written.records.items()}
    known |= {(NUMBER, name): [(name, value)] for name, value in changes.facts.items()}
    for fault in changes.statuses:
        known.pop((FAULT, fault), None)
    links += [(*of, _digest_of(known[of]) if of in known else content(db, *of, version), version) for of in touched]
    last = _append(db, links or [(OTHER, "", GONE, version)])
    if last.number > MOST and last.number % (MOST // 4) < len(links):
        _prune(db, last.number)
        return head(db)
    return last


def _prune(db: sqlite3.Connection, last: int) -> None:
    """Let the oldest links go, after what they say of rows that are there has been said again."""
    select = "SELECT max(number), kind, subject, content, version FROM link GROUP BY kind, subject"
    latest = db.execute(select).fetchall()
    alive = sorted(row for row in latest if row[1] in _ROWS and row[3] != GONE)
    first = last - max(MOST, 2 * len(alive))
    if first <= 1 or db.execute("SELECT 1 FROM link WHERE number = ?", (first,)).fetchone() is None:
        return
    # The content is that of the old link: a later change by another writer stays visible.
    _append(db, [link for number, *link in alive if number <= first])
    db.execute("DELETE FROM link WHERE number < ?", (first,))
    db.execute("UPDATE link SET kind = ?, subject = '', content = ? WHERE number = ?", (ANCHOR, GONE, first))


def verify(db: sqlite3.Connection) -> Verdict:
    """Return what of a file is as its chain says.

    Raises:
        sqlite3.Error: it cannot be read.
    """
    verdict = Verdict()
    latest: dict[tuple[str, str], tuple[int, bytes, int]] = {}
    before = NO_HEAD
    for number, kind, subject, of, digest, version in db.execute(_LINKS).fetchall():
        wrong = _wrong_link(before, number, kind, subject, of, digest, version)
        if wrong:
            verdict.broken.append(Broken(str(kind), str(subject), number, wrong))
        before = Head(number, digest if isinstance(digest, bytes) else GONE)
        verdict.links += 1
        if kind in _ROWS:
            latest[kind, subject] = (number, of, version if _is_known(version) else len(schema.MIGRATIONS))
        elif kind == CLEAR:
            verdict.counted[CLEAR] = verdict.counted.get(CLEAR, 0) + 1
    verdict.head = before
    if not verdict.links:
        verdict.broken.append(Broken("chain", "", 0, "its links are gone"))
    for kind, subject in _subjects(db):
        link, of, version = latest.pop((kind, subject), (0, GONE, len(schema.MIGRATIONS)))
        if content(db, kind, subject, version) == of:
            verdict.counted[kind] = verdict.counted.get(kind, 0) + 1
        else:
            reason = "is not what was written" if link and of != GONE else "was not written by a gateway"
            verdict.broken.append(Broken(kind, subject, link, reason))
    for (kind, subject), (link, of, _) in latest.items():
        if of != GONE:
            verdict.broken.append(Broken(kind, subject, link, "is not there any more"))
    verdict.broken.sort(key=lambda broken: broken.link or before.number + 1)
    return verdict


def _is_known(version: object) -> bool:
    return isinstance(version, int) and FIRST_VERSION <= version <= len(schema.MIGRATIONS)


def _wrong_link(before: Head, number: int, kind: str, subject: str, of: bytes, digest: bytes, version: int) -> str:
    """Return what is wrong with a link that comes after another one, "" if nothing is."""
    if before == NO_HEAD and kind == ANCHOR:
        return ""
    if number != before.number + 1:
        return f"links {before.number + 1} to {number - 1} are gone"
    ours = _is_known(version) and isinstance(of, bytes) and isinstance(digest, bytes)
    if not ours or digest != _link_digest(before.digest, number, kind, subject, of, version):
        return "the link is not what was written"
    return ""
