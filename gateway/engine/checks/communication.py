"""Communication monitor: timeout, alive counter, CRC, length and values of each watched message.

It stands beside the decoder and judges the frame itself, before any other monitor sees its signals:
a frame that is too short, fails its CRC or repeats its alive counter never reaches the mailbox, so
that corrupt data cannot look like a physical fault. A jump of the counter (frames lost) is reported,
but the frame's data are good and are used (AUTOSAR E2E: OKSOMELOST against REPEATED).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from gateway.common.times import NEVER
from gateway.engine.checks import senders
from gateway.engine.checks.kinds import KINDS, LENGTH, TIMEOUT, VALUE
from gateway.engine.checks.message import Params
from gateway.engine.checks.senders import SenderConst, SenderState
from gateway.engine.instances import FaultSlot
from gateway.signals.bits import field_of, mask_of
from gateway.signals.database import Database
from gateway.signals.protection import protection
from gateway.signals.protection.params import protection_for
from gateway.signals.protection.protection import Protection, ProtectionConst, Tables
from gateway.signals.tables import DecodePlan, SignalRef
from gateway_fdi.errors import InputError, under
from gateway_fdi.jit import Record, i4, i4s, i8, means, u1, u8, u8s

if TYPE_CHECKING:
    from cantools.database.can import Message

#: How a message comes: it does; it has not yet since its bus woke; its time is over, and others may stop, too (see
#: ``activity``); it is missing.
COMES, NOT_YET, STOPPED, MISSING = range(4)
#: A timeout has CYCLES cycles at most. A frame is missing in a gap of more than MISSES cycles. People write timeouts of
#: fewer cycles: the mean of the FIRST gaps of a message is then its cycle. One of more than LONG, as of a recorder that
#: loses frames, says nothing of it where `most` does. A frame that comes within a gap's SOON-th part was late.
CYCLES, MISSES, FIRST, LONG, SOON = 5.0, 1.5625, 16, 7.5, 5

#: Verdict on a frame: its data may be used.
ACCEPT = 0
#: Verdict on a frame: its data must not be used.
REJECT = 1
#: Verdict on a frame: some of its signals carry no value; a monitor that asks for that may use the others.
IN_PART = 2

#: Evidence for a checksum's rule is counted in half bits (see ``weigh_rule``). From this much on the rule is the
#: sender's: any frames give it by chance once in 2**20 times.
PROVEN = 40
#: Evidence against it from a wrong frame: a rule of 4 bits does not gain if every other frame is wrong.
AGAINST = 7
#: From this number of bits on every right frame is evidence, with fewer only if its payload is another one.
WIDE = 8
#: Number of wrong frames, before the rule is proven, from which on it is doubted.
MISFITS = 20
#: Number of these that are kept, to try other rules on.
SAMPLES = 4
#: How often the time of a missing message starts again because frames were lost on our side.
MOST_LOSSES = 10


class CheckPlace(Record):
    """Places in other tables."""

    fault: Annotated[i4s, len(KINDS)] = means("the engine's index of each fault; -1: not asked for")
    presence: i4 = means("place of a multiplexed signal of the protection among the message's; -1: always there")
    timer: i4 = means("its timer")
    row: i4 = means("of its message")
    sync: i4 = means("of SecOC: place of the check of the freshness master's message; -1: it needs none")
    bus: u1 = means("number of the bus")
    sender: i4 = means("number of its sender; below 0: nobody names it, it is alone")


class CheckConst(Record):
    """Limits of the message."""

    timeout_ns: i8 = means(unit="ns")
    wake_ns: i8 = means("time to come after the bus was silent as a whole", "ns")
    length: i4 = means("least length", "byte")
    need: i4 = means("length from which on a frame has its checksum and alive counter", "byte")
    only_length: i4 = means("the one length that it may have; 0: any", "byte")
    cycle_ns: i8 = means("of E2E's state machine: so long without a frame is no new data; 0: not looked at", "ns")
    rule: i8 = means("digest of the checksum's rule; 0: there is none")
    protection: ProtectionConst = means("checksum, alive counter, header")


class CheckState(Record):
    """State of the message's checks."""

    deadline_ns: i8 = means(unit="ns")
    silent_ns: i8 = means(unit="ns")
    silent_sources: i4 = means("of J1939: further source addresses that are silent")
    losses: i4 = means("how often its time has started anew since frames were lost on our side")
    parked_ns: i8 = means("when its time was over while nobody was heard; 0: it was not", "ns")
    parks: i4 = means("how often that was so since it came")
    asleep: u1 = means("whether its time was over while all slept")
    coming: u1 = means("COMES, NOT_YET, STOPPED or MISSING")
    overdue_ns: i8 = means("when its time was over, where it STOPPED", "ns")
    wide_ns: i8 = means("a frame is missing in a gap of more", "ns")
    first: i4 = means("gaps of which wide_ns is made, at most FIRST")
    span_ns: i8 = means("time of these together", "ns")
    last_counter: i8 = means("alive counter of the last frame")
    passed: i8 = means("frames whose checksum was right since the rule was proven")
    weighed: u8 = means("hash of the last right payload before the rule was proven")
    proof: i4 = means("what speaks for the rule of the checksum, -PROVEN to PROVEN", "half bit")
    longest: i4 = means("length of its longest frame", "byte")
    fitted: u1 = means("whether a frame had the one length that it may have")
    signs: u1 = means("kinds of check, a bit each, by which its sender has another software")
    told: u1 = means("those of them that are told")
    counts: u1 = means("whether its alive counter rose as it should since it came")
    unread: i4 = means("frames rejected since the counter was last read")
    misfits: i4 = means("frames whose checksum was wrong before the rule was proven")
    seen: u1 = means("1: last_counter is known")
    window: u1 = means("of E2E: NO_DATA, STARTING, VALID, INVALID")
    came_ns: i8 = means("when a frame was last taken into it; 0: never", "ns")
    ok: u8 = means("bit k: the frame k frames ago was right")
    wrong: u8 = means("bit k: its checksum was not")
    samples: Annotated[u8s, SAMPLES, 8] = means("payloads of misfits")
    lengths: Annotated[i4s, SAMPLES] = means("lengths of misfits", "byte")
    fresh: u8 = means("of SecOC: the least freshness value that is new")
    trial: u8 = means("the same by a single frame, to be confirmed; of the master: its value before the last trip")
    sought: i8 = means("values that were looked for since one was right")
    synced: u1 = means("1: none of its frames passed unheard since its value was right")


_COUNTER = ("protection.has_counter", "protection.counter", "protection.modulus", "protection.first")

#: Each state of a check, and the constants it is counted in: a reload keeps it where these are as they were.
COUNTED_IN: Mapping[tuple[str, ...], tuple[str, ...]] = {
    (
        "deadline_ns", "silent_ns", "losses", "parked_ns", "parks", "asleep", "coming", "overdue_ns",
        "wide_ns", "first", "span_ns",
    ): ("timeout_ns",),
    ("last_counter", "unread", "seen", "other_counter", "other_seen", "odd", "twice"): _COUNTER,
    ("left", "at", "filled", "stamps", "content", "wraps", "crowded", "last_ns", "blamed", "before"): (
        "most_ns", "stride", "slots",
    ),
    ("longest",): ("length",),
    ("fitted",): ("only_length",),
    ("signs", "told", "counts"): (),
    ("silent_sources",): ("timeout_ns",),
    ("passed", "weighed", "proof", "misfits", "samples", "lengths"): ("rule",),
    ("fresh", "trial", "sought", "synced"): ("rule",),
    # A window saw right and wrong frames. Its sizes and limits are asked at the next frame.
    ("window", "came_ns", "ok", "wrong"): (
        "rule", *_COUNTER, "protection.max_step", "protection.strict", "protection.windowed",
    ),
}  # fmt: skip


class CheckRun(Record):
    """The run of passes that its last frames are (see engine.checks.runs)."""

    steady: u1 = means("whether a frame that passes with the usual results goes on with it")
    counted: u1 = means("whether the alive counter is tested")
    summed: u1 = means("whether a checksum is tested")
    usual_length: i4 = means("length of its frames", "byte")
    usual_step: i4 = means("of the alive counter")
    gate_changes: i8 = means("of the clock, when the gates of its tests were last asked")
    run: i8 = means("frames that the buckets have not been told of")
    run_since_ns: i8 = means("the first of them, by the wall clock", "ns")
    run_until_ns: i8 = means("the last of them", "ns")


#: Fields that a frame of a run touches: two lines of the cache.
_NEAR = (
    "steady", "counted", "summed", "seen", "usual_length", "usual_step", "unread", "timeout_ns", "deadline_ns",
    "wide_ns", "first", "silent_ns", "losses", "coming", "parks", "last_counter", "gate_changes", "run", "run_since_ns",
    "run_until_ns", "stride", "left", "last_ns", "blamed", "protection", "most_ns", "slots", "at", "filled", "crowded",
    "wraps", "stamps", "one_ns", "repeats",
)  # fmt: skip


class Check(CheckState, SenderState, CheckConst, SenderConst, CheckPlace, CheckRun, near=_NEAR):
    """The checks of one message."""


@dataclass(frozen=True)
class CheckInstance:
    """The configured communication checks of one message of a bus.

    Attributes:
        params: its settings.
        bus: its index.
        name: first part of its fault ids.
        key: where the configuration has it, for errors: ``bus[0].check[1]``.
    """

    params: Params
    bus: int = 0
    name: str = ""
    key: str = ""


def signals_of(check: CheckInstance, database: Database) -> list[SignalRef]:
    """Return the signals that a check needs decoded: those whose presence a multiplexer decides.

    Raises:
        InputError: the message is not there; its protection does not fit it.
    """
    message = _message(check, database)
    with under(_key(check)):
        return _deciding(check, message, protection_for(message, check.params))


def _deciding(check: CheckInstance, message: Message, asked: Protection) -> list[SignalRef]:
    multiplexed = [signal for signal in message.signals if signal.multiplexer_ids]
    if not multiplexed:
        return []
    taken = _bits(asked)
    return [
        SignalRef(check.bus, message.name, signal.name) for signal in multiplexed if mask_of(field_of(signal)) & taken
    ]


def _bits(asked: Protection) -> int:
    """Return the bits of checksum and alive counter, bit 0 of the first byte lowest."""
    fields = [] if asked.checksum is None else [asked.field]
    fields += [] if asked.counter is None else [asked.counter.field]
    return sum(mask_of(field) for field in fields)


def _key(check: CheckInstance) -> str:
    return check.key or f'check of "{check.params.message}"'


def _message(check: CheckInstance, database: Database) -> Message:
    with under(f"{_key(check)}.message", check.params.message):
        return database.message(check.params.message)


def fill(
    row: Any,
    check: CheckInstance,
    plan: DecodePlan,
    database: Database,
    first_fault: int,
    crcs: Tables,
    *,
    wake_ms: float = 0.0,
    named: Collection[str] = (),
) -> list[FaultSlot]:
    """Fill one row of checks; returns the faults it can report, in order.

    Args:
        row: of :class:`Check`.
        check: what is asked for.
        plan: the decode tables.
        database: of its bus.
        first_fault: place of its first fault.
        crcs: tables of checksums.
        wake_ms: of its bus [ms].
        named: ids of faults that the configuration names. Frames that always were short fail where the fault of their
            length is one of them.
    """
    p, message = check.params, _message(check, database)
    place = plan.message(check.bus, p.message)
    with under(_key(check)):
        asked = protection_for(message, p)
    slots: list[FaultSlot] = []
    row["row"] = place
    places = [-1] * len(KINDS)
    for k, kind in enumerate(KINDS):
        if not kind.asked(p, asked) or (k == VALUE and not plan.messages[place]["floats"]):
            continue
        fault = kind.fault_of(p)
        if k == TIMEOUT and plan.by_pgn[place]:
            fault = replace(fault, evidence=(*fault.evidence, "source address"))
        places[k] = first_fault + len(slots)
        slots.append(FaultSlot(f"{check.name}.{fault.name}", fault, check.bus))
    row["fault"] = places
    row["bus"] = check.bus
    row["length"] = message.length
    if named and f"{check.name}.{KINDS[LENGTH].fault.name}" in named:
        row["longest"] = message.length
    row["only_length"] = 0 if isinstance(p.length, bool) else p.length
    row["need"] = (_bits(asked).bit_length() + 7) // 8
    senders.fill(row, p.most)
    row["timeout_ns"] = round((p.timeout_ms or 0) * 1e6)
    row["wake_ns"] = round(max(p.timeout_ms or 0, wake_ms if p.wake_ms is None else p.wake_ms) * 1e6)
    row["cycle_ns"] = round((p.cycle_ms or 0) * 1e6)
    row["deadline_ns"] = NEVER
    row["wide_ns"] = round(MISSES / CYCLES * row["timeout_ns"])
    cycle_ns = row["one_ns"] / max(row["stride"] * row["slots"], 1)
    if 0 < cycle_ns < row["timeout_ns"] / LONG:
        row["wide_ns"], row["first"] = round(MISSES * cycle_ns), FIRST
    row["rule"] = protection.digest(asked, message.frame_id)
    row["presence"] = row["sync"] = -1
    for ref in _deciding(check, message, asked):
        row["presence"] = plan.position(*ref)
    protection.fill(row["protection"], asked, crcs)
    if asked.freshness is not None and not asked.freshness.sync:
        row["fresh"] = asked.freshness.start
    return slots


def connect_synced(rows: Any, checks: Sequence[CheckInstance]) -> None:
    """Tell the checks of messages whose freshness a master synchronises where the check of its message is.

    Raises:
        InputError: it is not checked, or its counters have other lengths.
    """
    for k, check in enumerate(checks):
        asked = check.params.secoc
        if asked is None or asked.sync is None:
            continue
        of = [j for j, other in enumerate(checks) if (other.bus, other.params.message) == (check.bus, asked.sync)]
        master = checks[of[0]].params.secoc if of else None
        with under(_key(check)):
            if master is None or master.profile != "sync":
                text = 'this bus has no check of a message of that name with secoc = { profile = "sync", ... }'
                raise InputError(text, key="secoc.sync", value=asked.sync)
            for name in ("trip", "reset"):
                if getattr(master, name) != getattr(asked, name):
                    text = f"{asked.sync} has {getattr(master, name)} bits"
                    raise InputError(text, key=f"secoc.{name}", value=getattr(asked, name))
        rows[k]["sync"] = of[0]
