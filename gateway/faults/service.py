"""A fault memory file from outside: list, show, clear, beside a daemon or without one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gateway.faults import chain
from gateway.faults.catalogue import Catalogue
from gateway.faults.clearing import AskedClear
from gateway.faults.dtc import ALL_DTCS, Dtc
from gateway.faults.entries import Entry, entry_of
from gateway.faults.fleet import LIMITS
from gateway.faults.interventions import DONE, Intervention
from gateway.faults.ledger import OVERFLOW
from gateway.faults.lock import InUseError, is_kept, is_unsaved
from gateway.faults.memory import FaultMemory
from gateway.faults.records import TOLD, Record, Recording
from gateway.faults.remedy import severity_names
from gateway.faults.restarts import last_restart
from gateway.faults.status import Status
from gateway.faults.store import OutdatedError, Store, last_links
from gateway.faults.summary import NO_RESULT, Summary, summary_of
from gateway.faults.vehicle import EcuDtc
from gateway.host.process import user_in_words
from gateway_fdi.errors import GatewayError, InputError


def as_dict(entry: Entry) -> dict[str, Any]:
    """Return an entry in the form of the JSON contract."""
    cause = entry.record.cause
    return {
        "dtc": str(entry.dtc),
        "fault": entry.fault,
        "status": int(entry.status),
        "confirmed": bool(entry.status & Status.CONFIRMED_DTC),
        **{name: getattr(entry.record, name) for name in TOLD},
        "freeze_frames": [
            {"record": frame.number, "t_ns": frame.t_ns, "signals": frame.content} for frame in entry.freeze_frames
        ],
        "cause": None if cause is None else cause.as_dict(),
    }


def open_reader(path: Path) -> Store:
    """Open a fault memory for reading; one of an earlier version is brought up to date first."""
    try:
        return Store(path, write=False)
    except OutdatedError:
        Store(path).close()
        return Store(path, write=False)


def _named(facts: tuple[str, int, str] | None) -> dict[str, Any]:
    """Return what a fault is called; null where the gateway that wrote the memory did not say."""
    if facts is None:
        return {"description": None, "severity": None, "class": None, "remedy": None}
    description, severity, remedy = facts
    name, kind = severity_names(severity)
    return {"description": description, "severity": name, "class": kind, "remedy": remedy}


def list_entries(path: Path) -> list[dict[str, Any]]:
    """Return every entry of a fault memory; ``stored`` is false while its gateway knows more than it could write.

    Raises:
        InputError: there is none at this path.
    """
    with closing(open_reader(path)) as store:
        return entries_in(store, store.load(), stored=not is_unsaved(path))


def summary(path: Path) -> Summary:
    """Return verdict and causes of a fault memory, and how many tests have no result in this operation cycle.

    Raises:
        InputError: there is none at this path.
    """
    with closing(open_reader(path)) as store:
        records = store.load()
        entries = entries_in(store, records, stored=not is_unsaved(path))
        known = store.descriptions()
    done = {record.id for record in records if not record.status & Status.NOT_COMPLETED_THIS_CYCLE}
    return summary_of(entries, tests=len(known), not_judged=[NO_RESULT] * len(known.keys() - done))


def entries_in(store: Store, records: Sequence[Record], *, stored: bool) -> list[dict[str, Any]]:
    """Return the entries of an open fault memory.

    Args:
        store: that is open.
        records: result of :meth:`Store.load`.
        stored: whether the file has all that is known.
    """
    permanent = {entry.fault for entry in store.permanent()}
    recorded, facts = store.recorded(), store.facts()
    told = store.descriptions()
    return [
        {
            **as_dict(entry_of(record)),
            **_named(told.get(record.id)),
            "permanent": record.id in permanent,
            "recordings": recorded.get(record.id, 0),
            "limits": facts.get(f"{LIMITS}{record.id}", 0),
            "stored": stored,
        }
        for record in records
        if record.occurrence > 0
    ]


def waiting(path: Path) -> int:
    """Return how many verdicts of a gateway that has ended suddenly are in its journal only; 0: it cannot be read."""
    if is_kept(path):
        return 0
    try:
        store = Store(path, write=False)
    except InputError:
        return 0
    with closing(store), suppress(InputError):
        return len(store.waiting())
    return 0


def daemon_state(path: Path) -> dict[str, Any]:
    """Return whether a gateway keeps this memory now, has stored all it knows, and its last report of its buses.

    Raises:
        InputError: there is no fault memory at this path.
    """
    running = is_kept(path)
    with closing(open_reader(path)) as store:
        return {
            "memory": str(path),
            "running": running,
            "stored": not is_unsaved(path),
            "buses": store.buses(),
            "restarts": restarts_in(store),
        }


def restarts_in(store: Store) -> dict[str, Any]:
    """Return the restarts of an open fault memory (see :func:`restarts`)."""
    found = last_restart(store.facts())
    return {"count": 0} if found is None else asdict(found)


def restarts(path: Path) -> dict[str, Any]:
    """Return how many starts found that the last gateway was not stopped but died; of these the last one.

    Raises:
        InputError: there is no fault memory at this path.
    """
    with closing(open_reader(path)) as store:
        return restarts_in(store)


def overflowed(path: Path) -> bool:
    """Return whether an entry had to be given up, or could not be made, since the last clear of all.

    Raises:
        InputError: there is no fault memory at this path.
    """
    with closing(open_reader(path)) as store:
        return bool(store.facts().get(OVERFLOW, 0))


def intervention_as_dict(each: Intervention) -> dict[str, Any]:
    """Return an intervention in the form of the JSON contract."""
    return {
        "t_ns": each.t_ns,
        "first_ns": each.first_ns,
        "count": each.count,
        "protocol": each.protocol,
        "bus": each.bus,
        "address": each.address,
        "session": each.session,
        "security": each.security,
        "role": each.role,
        "action": each.action,
        "request": each.request.hex(),
        "outcome": "done" if each.outcome == DONE else "refused",
        "nrc": each.outcome,
    }


def interventions(path: Path) -> list[dict[str, Any]]:
    """Return what testers did to the gateway that keeps this memory, the oldest first.

    Raises:
        InputError: there is no fault memory at this path.
    """
    with closing(open_reader(path)) as store:
        return [intervention_as_dict(each) for each in store.interventions()]


def ecu_dtc_as_dict(each: EcuDtc) -> dict[str, Any]:
    """Return a DTC of another ECU in the form of the JSON contract."""
    return {**asdict(each), "snapshots": dict(each.snapshots)}


def ecu_dtcs(path: Path) -> list[dict[str, Any]]:
    """Return the DTCs of other ECUs.

    Raises:
        InputError: there is no fault memory at this path.
    """
    with closing(open_reader(path)) as store:
        return [ecu_dtc_as_dict(each) for each in store.ecu_dtcs()]


def verify(path: Path) -> dict[str, Any]:
    """Return what of a fault memory is whole: rows that are as they were written, by kind, and those that are not.

    Raises:
        InputError: there is no file, or one of an earlier version, which has no chain.
    """
    if not path.exists():
        raise InputError("there is no fault memory here", file=path)
    known = last_links(path)
    try:
        with closing(Store(path, write=False)) as store:
            store.refuse_damaged()
            verdict = store.verify(known)
            store.load()
    except OutdatedError:
        raise
    except InputError as error:
        verdict = chain.Verdict(broken=[chain.Broken("file", "", 0, error.message)])
    return {
        "memory": str(path),
        "whole": not verdict.broken,
        "stored": not is_unsaved(path),
        "counted": verdict.counted,
        "links": verdict.links,
        "last_link": verdict.head.number,
        "digest": verdict.head.digest.hex(),
        "broken": [{**broken._asdict(), "text": str(broken)} for broken in verdict.broken],
    }


def near_misses(path: Path) -> list[dict[str, Any]]:
    """Return the faults that came near a failure, or had one: how often, and how near.

    Raises:
        InputError: there is no fault memory at this path.
    """
    with closing(open_reader(path)) as store:
        return [
            {
                "fault": record.id,
                "dtc": str(Dtc(record.dtc)),
                "near_misses": record.near_misses,
                "peak_fdc": record.peak_fdc,
            }
            for record in store.load()
            if record.near_misses or record.peak_fdc > 0
        ]


def recordings(path: Path, dtc: str) -> list[Recording]:
    """Return the frames recorded around the failures of one DTC, the oldest recording first.

    Raises:
        InputError: it is not a DTC, or there is no entry of it.
    """
    fault = str(show(path, dtc)["fault"])
    with closing(open_reader(path)) as store:
        return store.recordings(fault)


def show(path: Path, dtc: str) -> dict[str, Any]:
    """Return the entry of one DTC.

    Raises:
        InputError: it is not a DTC, or the memory has no entry of it.
    """
    wanted = str(Dtc.parse(dtc))
    entries = list_entries(path)
    for entry in entries:
        if entry["dtc"] == wanted:
            return entry
    known = ", ".join(entry["dtc"] for entry in entries) or "none"
    raise InputError(f"no entry of this DTC; the memory has {known}", file=path, value=wanted)


def clear(path: Path, dtc: str | None = None, *, force: bool = False, why: str = "", patience_s: float = 5.0) -> int:
    """Clear one DTC, or all; a daemon that keeps the memory does it by its rules of access, else this process.

    Args:
        path: of the fault memory.
        dtc: which one; None for all.
        force: whether to override the daemon's rules of access; it is noted.
        why: the reason, which is noted, too.
        patience_s: how long to wait for the daemon [s].

    Returns:
        how many entries were cleared.

    Raises:
        InputError: there is no fault memory, or ``dtc`` is not one DTC.
        GatewayError: the daemon did not answer, or refused; nothing was cleared.
    """
    group = ALL_DTCS if dtc is None else _one(dtc)
    if not path.exists():
        raise InputError("there is no fault memory here", file=path)
    try:
        store = Store(path)
    except InUseError:
        return _ask_writer(path, AskedClear(group, f"{user_in_words()}, command line", force, why), patience_s)
    with closing(store):
        memory = FaultMemory(Catalogue(()), store)
        count = sum(group in (ALL_DTCS, entry.dtc.value) for entry in memory.entries())
        memory.clear(group)
        request = b"\x14" + group.to_bytes(3, "big")
        by = f"{user_in_words()}, command line{f': {why}' if why else ''}"
        memory.ledger.note_intervention(Intervention(time.time_ns(), "local", "", 0, "clear", request, role=by))
        memory.commit(final=True)
        return count


def _one(text: str) -> int:
    """Read the DTC of a clear; by its number the group of all would be taken for one."""
    value = Dtc.parse(text).value
    if value == ALL_DTCS:
        raise InputError("this is the group of all DTCs; name none to clear all", value=text)
    return value


def _ask_writer(path: Path, asked: AskedClear, patience_s: float) -> int:
    with closing(Store(path, write=False)) as store:
        request = store.request("clear", str(asked))
        limit = time.monotonic() + patience_s
        try:
            while store.answer(request) is None and time.monotonic() < limit:
                time.sleep(0.02)
        finally:  # also at Ctrl-C: a request without a waiting process is not done later
            answer = store.withdraw(request)
    if answer is None:
        raise GatewayError(f"{path}: the gateway that keeps this memory does not answer")
    if answer < 0:
        raise GatewayError(
            f"{path}: the gateway that keeps this memory refuses to clear now (0x{-answer:02X}): conditions or security"
            " of [access]; --force overrides them, which is noted"
        )
    return answer
