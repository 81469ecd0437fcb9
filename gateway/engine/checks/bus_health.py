"""Health of a bus: bus-off, error passive, error rate, interface lost, frames lost in a queue, silence as a whole.

It judges the kernel's error frames, and the frames by which the gateway tells the condition of its interfaces (see
``gateway.bus.conditions``). A frame that is received proves that the controller is on the bus, even if it was reported
off before.

Failure type bytes (SAE J2012): 88 bus off, 08 bus signal or message failure, 81 invalid serial data received, 31 no
signal, 04 system internal failure (the gateway's own queue), 87 missing message (of everybody, see ``silence``), 55 not
configured (an identifier that nobody has, see ``strangers``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from gateway.bus.conditions import (
    ACTIVE,
    BUS_ERROR,
    BUS_OFF,
    CONTROLLER,
    LOSS,
    LOST,
    LOST_ARBITRATION,
    NO_ACK,
    PROTOCOL,
    RESTARTED,
    RUNNING,
    RX_OVERFLOW,
    RX_PASSIVE,
    RX_WARNING,
    TRANSCEIVER,
    TX_OVERFLOW,
    TX_PASSIVE,
    TX_TIMEOUT,
    TX_WARNING,
)
from gateway.common.times import NEVER
from gateway.engine.checks.clock_health import OWN_FAULTS
from gateway.engine.instances import FaultSlot
from gateway.monitors.contract import Debounce, Fault, MonitorParams
from gateway_fdi.jit import Record, f8, f8s, i4, i4s, i8, i8s, kernel, means, u1

OFF, PASSIVE, ERRORS, GONE, OVERFLOW, SILENT, UNKNOWN, CLOCK_STEPPED = range(8)

#: Treatment of unknown identifiers.
NONE, TELL, FAULT = range(3)
_UNKNOWN = {"none": NONE, "tell": TELL, "fault": FAULT}

_AT_ONCE = Debounce(failed_after=1, passed_after=1, jump_down=True)

FAULTS = (
    Fault(
        "bus_off",
        "U0001-88",
        "controller bus-off",
        ("transmit errors", "receive errors"),
        _AT_ONCE,
        remedy="check wires, termination (60 Ohm between CAN_H and CAN_L) and bit rate of the bus",
        tested="error counter",
    ),
    Fault(
        "bus_passive",
        "U0001-08",
        "controller error passive",
        ("transmit errors", "receive errors"),
        _AT_ONCE,
        remedy="check that another node is on the bus, its wires, termination and bit rate",
        tested="error counter",
    ),
    Fault(
        "bus_errors",
        "U0001-81",
        "more protocol errors in the window than allowed",
        ("error classes", "protocol error", "location"),
        _AT_ONCE,
        remedy="check wires, termination and bit rate of the bus; the evidence says which errors",
        tested="errors in the window",
    ),
    Fault(
        "bus_lost",
        "U0001-31",
        "interface missing or down",
        (),
        _AT_ONCE,
        remedy="set the interface up (ip link set can0 up), plug the adapter in; gateway doctor shows both",
    ),
    Fault(
        "bus_overflow",
        "U0001-04",
        "frames lost in a queue before they were read",
        ("lost since the start",),
        _AT_ONCE,
        remedy="give it a larger buffer (?rcvbuf= in its URI, net.core.rmem_max), or less to do",
        tested="frames lost",
    ),
    Fault(
        "bus_silent",
        "U0001-87",
        "no frame of any sender: the bus sleeps, or is cut off",
        ("silent [ms]",),
        _AT_ONCE,
        remedy="check the wires between the gateway and the bus, and its supply; if the bus may sleep, say when it is"
        " awake ([power] awake)",
        tested="silent [ms]",
    ),
    Fault(
        "unknown",
        "U0001-55",
        "an identifier that nobody of this bus has: a device was added, or a frame is of another bus",
        ("identifier", "bytes 0 to 3", "bytes 4 to 7", "length [byte]", "bus that knows it"),
        Debounce(failed_after=3, passed_after=1, jump_down=True),
        remedy="find the device that sends it; if it belongs here: its database, or [bus.health] known",
        tested="frames of it",
    ),
)

#: Bases of the DTCs of the first bus, the second, ... (SAE J2012: high speed CAN, then vehicle communication buses A
#: to E, then the other CAN buses).
CODES = ("U0001", "U0028", "U0037", "U0046", "U0055", "U0064", "U0010", "U0019")

#: Knowledge about the silence of a bus.
WHOLE, AWAITED, SPOKEN = range(3)

#: Activity of a bus as a whole (see ``activity``), and the words for it.
ASLEEP, WAKING, AWAKE, FALLING, PART = range(5)
ACTIVITIES = ("asleep", "waking", "running", "falling asleep", "running in part")

#: Counters of error frames, by class.
COUNTED = {
    "tx_timeout": TX_TIMEOUT,
    "lost_arbitration": LOST_ARBITRATION,
    "controller": CONTROLLER,
    "protocol": PROTOCOL,
    "transceiver": TRANSCEIVER,
    "no_ack": NO_ACK,
    "bus_off": BUS_OFF,
    "bus_error": BUS_ERROR,
    "restarted": RESTARTED,
}
_CLASSES = np.asarray(list(COUNTED.values()), np.int64)

_WRONG = TX_TIMEOUT | PROTOCOL | TRANSCEIVER | NO_ACK | BUS_ERROR
_ALL = (1 << SILENT) - 1  # an interface that is up again says nothing of a silence


class Params(MonitorParams):
    """How the health of a bus is judged."""

    watched: bool = Field(True, description="false: error frames are counted, nothing is judged")
    code: str | None = Field(
        None,
        pattern=r"^U[0-3][0-9A-F]{3}$",
        description="first part of its DTCs; default: U0001, then U0028 (bus A), ...",
    )
    errors: int = Field(10, ge=1, le=1_000_000, description="protocol errors in the window that are a fault")
    window_ms: float = Field(1000.0, ge=1, le=3.6e6, description="window; this time without a fault heals it [ms]")
    silent_ms: float | None = Field(
        None,
        gt=0,
        le=3.6e6,
        description="the bus is silent as a whole after this time without any frame [ms]; default: when each of its"
        " senders has a message overdue, 10 s at most; not judged where one sender alone is watched",
    )
    wake_ms: float = Field(
        15_000.0,
        ge=0,
        le=3.6e6,
        description="after such a silence each message has this time to come [ms]; its timeout at least",
    )
    sleeps: bool = Field(
        False,
        description="it falls asleep, as in a car that is parked: senders stop one after the other, then it is silent",
    )
    settle_ms: float = Field(
        3000.0,
        ge=0,
        le=3.6e6,
        description="where it sleeps: a sender that stops is judged after this time [ms], in which no other stops",
    )
    unknown: Literal["none", "tell", "fault"] = Field(
        "none",
        description="identifiers that neither a database, a server, a tester nor an ECU that is asked has: told as a"
        " security event; a fault, too",
    )
    known: tuple[Annotated[int, Field(ge=0, le=0x1FFFFFFF)], ...] = Field(
        (), description="further identifiers that belong here; above 0x7FF: of 29 bits"
    )


class HealthPlace(Record):
    """Places in other tables, and settings that the state does not depend on."""

    fault: Annotated[i4s, len(FAULTS) + len(OWN_FAULTS)] = means("the engine's index of each fault; -1: not judged")
    timer: i4 = means("its timer")
    unknown: u1 = means("NONE, TELL or FAULT")
    most: i8 = means("errors in window_ns that are too many; of the gateway itself, us that the clock may be off")
    window_ns: i8 = means(unit="ns")
    quiet_ns: i8 = means("it is silent as a whole after so long without a frame; 0: not judged", "ns")
    gap_ns: i8 = means("a gap between two frames is unusual from here on", "ns")
    wake_ns: i8 = means("time to be heard after it was asleep", "ns")
    settle_ns: i8 = means("a sender that stops is judged after it; 0: at once, it does not sleep", "ns")


class HealthState(Record):
    """How it does."""

    failed: i4 = means("verdicts of the last frame, a bit for each fault")
    passed: i4 = means("likewise")
    bad: u1 = means("faults that any frame received disproves")
    count: i8 = means("errors in the window")
    since_ns: i8 = means(unit="ns")
    deadline_ns: i8 = means(unit="ns")
    until: Annotated[i8s, len(FAULTS) + len(OWN_FAULTS)] = means("when a fault heals by silence", "ns")
    lost: i8 = means("frames lost in a queue")
    heard_ns: i8 = means("when a frame was last received", "ns")
    talks_ns: i8 = means("when the last silence that was unusual ended", "ns")
    thin: f8 = means("share of the last windows of its messages that held fewer frames than their senders send")
    jumper: i4 = means("row of the message whose alive counter jumped last")
    jumped_ns: i8 = means("when it did; 0: none did", "ns")
    others_ns: i8 = means("when that of another message did last; 0: none did", "ns")
    silence: u1 = means("WHOLE: of all, or it was not heard yet, AWAITED: messages wait for a frame of anybody, SPOKEN")
    asleep: u1 = means("whether it may be silent: nobody is awake")
    activity: u1 = means("ASLEEP, WAKING, AWAKE, FALLING or PART")
    begun: u1 = means("whether it was AWAKE before")
    joined_ns: i8 = means("when a message last began to come after the bus was asleep", "ns")
    look_ns: i8 = means("when it is looked whether it is awake", "ns")
    stopped_ns: i8 = means("last frame of what was the first to be overdue, others settle_ns after it at most", "ns")
    dipped_ns: i8 = means("when a message first came again after a gap that a cranked engine makes; 0: none did", "ns")
    fell_ns: i8 = means("since when it is FALLING, or was last; 0: never", "ns")
    frames: i8 = means("frames received")
    watched: i8 = means("frames of messages with a timeout, since gaps were last weighed")
    gaps: i8 = means("gaps since then in which a frame of a message did not come, less those that came together")
    gapped: i4 = means("row of the message that had the last gap, and one; 0: none had")
    alone: i4 = means("its gaps in a row that are not counted yet")
    weighed_ns: i8 = means("when that was", "ns")
    lossy: u1 = means("whether it is told that frames of it get lost")
    signs: i4 = means("that its ECUs have another software than the one that the checks were made for")
    share: f8 = means("share of them, when gaps were last weighed")
    counts: Annotated[i8s, len(COUNTED)] = means("conditions so far, by COUNTED")
    value: f8 = means("value of the verdicts")
    limit: f8 = means("limit of the verdicts")
    evidence: Annotated[f8s, 3] = means("evidence of the verdicts")


class Health(HealthState, HealthPlace):
    """Health of one bus, or of the gateway itself: it has OWN_FAULTS, after those of buses."""


def codes_of(buses: Sequence[Params]) -> list[str]:
    """Return the first part of the DTCs of each bus: the one it asks for, else the next free one.

    Args:
        buses: settings, in the order of the buses.
    """
    free = iter([code for code in CODES if code not in {params.code for params in buses}])
    return [params.code or next(free, CODES[-1]) for params in buses]


def faults_of(code: str) -> tuple[Fault, ...]:
    """Return what the health of a bus can report, with the first part of its DTCs."""
    return tuple(replace(fault, dtc=code + fault.dtc[5:]) for fault in FAULTS)


@kernel
def heal_later(h: Any, fault: int, t_ns: int) -> None:
    """Let a fault of a bus heal after a window of silence from now."""
    h.until[fault] = t_ns + h.window_ns
    h.deadline_ns = min(h.deadline_ns, h.until[fault])


@kernel
def _note_condition(h: Any, t_ns: int, word: int) -> None:
    condition, lost = word & 0xFF, (word >> 32) & 0xFFFFFFFF
    if condition == RUNNING:
        h.passed = _ALL
        h.bad &= 1 << SILENT
        h.count = 0
    elif condition == LOST:
        h.failed = 1 << GONE
        h.bad |= 1 << GONE
        h.value, h.limit = 1.0, 0.0
    elif condition == LOSS:
        h.failed = 1 << OVERFLOW
        h.lost += lost
        h.value, h.limit = lost, 0.0
        h.evidence[0] = h.lost
        heal_later(h, OVERFLOW, t_ns)


@kernel
def _note_controller(h: Any, t_ns: int, controller: int, heard: int) -> int:
    """Take the state of the controller that an error frame tells; returns what is heard, as :func:`note`."""
    if controller & (RX_PASSIVE | TX_PASSIVE):
        h.failed |= 1 << PASSIVE
        h.limit = 127.0
    elif controller & (ACTIVE | RX_WARNING | TX_WARNING):
        h.passed |= 1 << PASSIVE  # both are below error passive
    if controller & ACTIVE:
        h.passed |= 1 << OFF
        if h.bad & (1 << OFF):
            h.bad &= 0xFF ^ (1 << OFF)
            heard = RUNNING
    if controller & RX_OVERFLOW and heard == 0:
        heard = LOSS
    if controller & (RX_OVERFLOW | TX_OVERFLOW):
        h.failed |= 1 << OVERFLOW
        heal_later(h, OVERFLOW, t_ns)
    return heard


@kernel
def note(h: Any, t_ns: int, can_id: int, word: int) -> int:
    """Take an error frame; its verdicts are in ``h.failed`` and ``h.passed``.

    Args:
        h: record of Health.
        t_ns: the frame's time.
        can_id: its identifier with flags.
        word: the first 8 bytes of its data, little endian.

    Returns:
        the condition that it tells; of the kernel's RUNNING: after bus off it hears again, LOSS: the controller had no
        room for what came, 0: neither.
    """
    h.failed = h.passed = 0
    classes = can_id & 0x1FFFFFFF
    if classes == 0:
        _note_condition(h, t_ns, word)
        return word & 0xFF
    for k in range(_CLASSES.shape[0]):
        if classes & _CLASSES[k]:
            h.counts[k] += 1
    heard = 0
    controller = (word >> 8) & 0xFF
    transmit, receive = (word >> 48) & 0xFF, (word >> 56) & 0xFF
    h.evidence[0], h.evidence[1] = transmit, receive
    h.value = max(transmit, receive)
    if classes & RESTARTED:
        h.passed |= 1 << OFF | 1 << PASSIVE
        h.bad &= 1 << SILENT
        heard = RUNNING
    if classes & CONTROLLER:
        heard = _note_controller(h, t_ns, controller, heard)
    if classes & BUS_OFF:
        h.failed |= 1 << OFF
        h.bad |= 1 << OFF
        h.limit = 255.0
        heard = 0
    if classes & _WRONG:
        if h.count == 0 or t_ns - h.since_ns > h.window_ns:
            h.since_ns = t_ns
            h.count = 0
        h.count += 1
        if h.count >= h.most:
            h.failed |= 1 << ERRORS
            h.value, h.limit = h.count, h.most
            h.evidence[0], h.evidence[1] = classes, (word >> 16) & 0xFF
            h.evidence[2] = (word >> 24) & 0xFF
            heal_later(h, ERRORS, t_ns)
    return heard


@kernel
def reports_loss(can_id: int, word: int) -> bool:
    """Return whether an error frame says that frames were lost on our side before it.

    Args:
        can_id: its identifier with flags.
        word: the first 8 bytes of its data, little endian.
    """
    classes = can_id & 0x1FFFFFFF
    if classes == 0:
        return word & 0xFF == LOSS
    return classes & CONTROLLER != 0 and (word >> 8) & RX_OVERFLOW != 0


@kernel
def note_step(h: Any, t_ns: int, step_s: float, steps: int) -> None:
    """Take a step of the wall clock; its verdict is in ``h.failed``.

    Args:
        h: the gateway's own record of Health.
        t_ns: when.
        step_s: by how much [s].
        steps: how many there have been.
    """
    h.failed, h.passed = 1 << CLOCK_STEPPED, 0
    h.value, h.limit = abs(step_s), h.most * 1e-6
    h.evidence[0], h.evidence[1], h.evidence[2] = step_s, steps, 0.0
    heal_later(h, CLOCK_STEPPED, t_ns)


@kernel
def watch_clock(h: Any, t_ns: int) -> None:
    """Begin to watch the clock: each window without a step is a passed test."""
    if h.fault[CLOCK_STEPPED] >= 0:
        heal_later(h, CLOCK_STEPPED, t_ns)


@kernel
def await_anybody(h: Any, t_ns: int) -> None:
    """Begin to listen: one that has slept, or was not heard yet, has its time to wake before it is silent."""
    if h.silence != WHOLE:
        h.silence = SPOKEN
        h.until[SILENT] = NEVER
    elif h.quiet_ns > 0:
        h.until[SILENT] = t_ns + max(h.quiet_ns, h.wake_ns)
        h.deadline_ns = min(h.deadline_ns, h.until[SILENT])


@kernel
def on_frame_received(h: Any) -> None:
    """Take a frame that was received while the bus was said to be off or lost."""
    h.failed = 0
    h.passed = h.bad
    h.bad = 0


@kernel
def on_timer(h: Any, t_ns: int) -> None:
    """Let what healed by silence up to a time pass; sets the next deadline."""
    h.failed = h.passed = 0
    h.deadline_ns = NEVER
    for k in range(h.until.shape[0]):
        if h.until[k] <= t_ns and k == SILENT:
            h.until[k] = NEVER  # judged where the other buses are known, see silence_steps
            h.silence = WHOLE
        elif h.until[k] <= t_ns:
            h.until[k] = t_ns + h.window_ns if k == CLOCK_STEPPED else NEVER
            h.passed |= 1 << k
        h.deadline_ns = min(h.deadline_ns, h.until[k])
    if h.look_ns > t_ns:
        h.deadline_ns = min(h.deadline_ns, h.look_ns)


class Silence(NamedTuple):
    """When a bus is silent as a whole: time without a frame, 0: not judged; shortest unusual gap [ns]."""

    quiet_ns: int = 0
    gap_ns: int = 0


@dataclass(frozen=True)
class BusInstance:
    """A bus, and how its health is judged.

    Attributes:
        name: of it.
        params: its settings.
        known: identifiers (with EXTENDED) that belong to it beside those of its databases.
        groups: identifiers whose whole parameter group (J1939) does.
    """

    name: str
    params: Params = field(default_factory=Params)
    known: tuple[int, ...] = ()
    groups: tuple[int, ...] = ()


def fill(row: Any, bus: BusInstance, index: int, code: str, first_fault: int, silence: Silence) -> list[FaultSlot]:
    """Fill the health of one bus; returns the faults it can report, in order."""
    p = bus.params
    row["most"], row["window_ns"] = p.errors, round(p.window_ms * 1e6)
    row["deadline_ns"] = NEVER
    row["until"] = row["look_ns"] = NEVER
    row["fault"] = -1
    if not p.watched:
        return []
    row["unknown"] = _UNKNOWN[p.unknown]
    kinds = [*range(SILENT), *[SILENT] * (silence.quiet_ns > 0), *[UNKNOWN] * (p.unknown == "fault")]
    if silence.quiet_ns > 0:
        row["bad"] = 1 << SILENT  # the first frame disproves it
    row["quiet_ns"], row["gap_ns"] = silence
    row["wake_ns"] = round(p.wake_ms * 1e6)
    row["settle_ns"] = round(p.settle_ms * 1e6) if p.sleeps else 0
    row["fault"][kinds] = first_fault + np.arange(len(kinds))
    return [FaultSlot(f"{bus.name}.{faults_of(code)[kind].name}", faults_of(code)[kind], index) for kind in kinds]
