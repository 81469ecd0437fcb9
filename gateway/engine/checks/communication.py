"""Communication monitor: timeout, alive counter, CRC, length and values of each watched message.

It stands beside the decoder and judges the frame itself, before any other monitor sees its signals:
a frame that is too short, fails its CRC or repeats its alive counter never reaches the mailbox, so
that corrupt data cannot look like a physical fault. A jump of the counter (frames lost) is reported,
but the frame's data are good and are used (AUTOSAR E2E: OKSOMELOST against REPEATED).

Failure type bytes (SAE J2012): 87 missing message, 82 alive counter incorrect, 83 protection
calculation incorrect, 81 invalid serial data received, 29 signal invalid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from gateway.common.times import NEVER
from gateway.common.tomlfile import StrictModel
from gateway.engine.instances import FaultSlot
from gateway.errors import InputError
from gateway.jit import Record, i4, i4s, i8, kernel, means, u1
from gateway.monitors.contract import Debounce, Fault, MonitorParams
from gateway.signals.crc import ALGORITHMS, crc8
from gateway.signals.database import Database
from gateway.signals.tables import DecodePlan, SignalRef

TIMEOUT, COUNTER, CRC, LENGTH, VALUE = range(5)

#: Verdict on a frame: its data may be used.
ACCEPT = 0
#: Verdict on a frame: its data must not be used.
REJECT = 1

FAULTS = (
    Fault(
        "timeout",
        "U0100-87",
        "message missing for longer than its timeout",
        ("silent [ms]",),
        Debounce(failed_after=1, passed_after=5),
        remedy="check the sender: powered, awake, its wires to this bus; and that it does send this message",
    ),
    Fault(
        "counter",
        "U0401-82",
        "alive counter jumped (frames lost) or stands still (frame repeated)",
        ("step", "last", "received"),
        Debounce(failed_after=3, passed_after=50),
        remedy="check the bus for lost frames (gateway doctor, load), the sender for a standstill",
    ),
    Fault(
        "crc",
        "U0401-83",
        "CRC does not match the payload",
        ("received", "computed"),
        Debounce(failed_after=2, passed_after=50),
        remedy="check the wires of the bus for disturbances; if every frame fails, the rule in [[bus.check]]",
    ),
    Fault(
        "length",
        "U0401-81",
        "frame shorter than its message",
        ("length [byte]",),
        Debounce(failed_after=2, passed_after=50),
        remedy="check the sender's software against the database",
    ),
    Fault(
        "value",
        "U0401-29",
        "a floating-point signal is no number, or far outside of its range in the database",
        ("signal's place in the message", "received"),
        Debounce(failed_after=2, passed_after=50),
        remedy="check what the sender computes; and the type of the signal in the database",
    ),
)


class CounterCheck(StrictModel):
    """Alive counter: a signal that every transmission raises by one, modulo its range."""

    signal: str = Field(description="name of the counter signal")
    max_step: int = Field(1, ge=1, description="largest step that is not a failure")


class CrcCheck(StrictModel):
    """CRC over the payload without the CRC byte, then the data id (low byte first)."""

    signal: str = Field(description="name of the CRC signal: 8 bits on a byte boundary")
    algorithm: Literal["crc8_sae_j1850", "crc8_autosar"] = Field(
        "crc8_sae_j1850", description="polynomial 0x1D, or 0x2F (AUTOSAR CRC8H2F)"
    )
    data_id: int | None = Field(None, ge=0, le=0xFFFF, description="16-bit data id appended to the payload")


#: Base code of a DTC in TOML: a network code without its failure type.
BaseCode = Annotated[str, Field(pattern=r"^U[0-3][0-9A-F]{3}$")]


class Params(MonitorParams):
    """Checks of one message."""

    message: str = Field(description="name of the message in the bus's database")
    timeout_ms: float | None = Field(None, gt=0, le=3.6e6, description="longest silence [ms]; none: not watched")
    counter: CounterCheck | None = None
    crc: CrcCheck | None = None
    length: bool = Field(True, description="judge frames shorter than the message")
    value: bool = Field(
        True,
        description="judge floating-point signals that somebody uses: NaN, infinite, far outside of their range",
    )
    lost: BaseCode = Field("U0100", description="base code of the timeout's DTC: lost communication, U01xx")
    invalid: BaseCode = Field("U0401", description="base code of the other checks' DTCs: invalid data received, U04xx")

    def fault_of(self, kind: int) -> Fault:
        """Return one of :data:`FAULTS` with the DTC it has for this message."""
        fault = FAULTS[kind]
        base = self.lost if kind == TIMEOUT else self.invalid
        return replace(fault, dtc=f"{base}-{fault.dtc.rpartition('-')[2]}")


class CheckPlace(Record):
    """Places in other tables."""

    fault: Annotated[i4s, len(FAULTS)] = means("the engine's index of each fault; -1: not asked for")
    counter: i4 = means("place of the counter among the message's signals")
    bus: u1


class CheckConst(Record):
    """What is asked of the message."""

    timeout_ns: i8 = means(unit="ns")
    modulo: i4
    max_step: i4
    crc_byte: i4
    data_id: i4
    crc_init: i4
    crc_xor: i4
    crc_table: i4
    length: i4


class CheckState(Record):
    """What has come."""

    deadline_ns: i8 = means(unit="ns")
    silent_ns: i8 = means(unit="ns")
    last_counter: i4
    unread: i4 = means("frames rejected since the counter was last read")
    seen: u1


class Check(CheckState, CheckConst, CheckPlace):
    """The checks of one message."""


@kernel
def check_crc(check: Any, words: Any, length: int, tables: Any) -> tuple[int, int]:
    """Return the CRC that a frame carries and the one its payload asks for.

    Args:
        check: record of :class:`Check`.
        words: payload as 8 little-endian uint64 words.
        length: payload length [byte].
        tables: uint8, shape (algorithms, 256).
    """
    at = check.crc_byte
    received = np.int64((words[at >> 3] >> np.uint64((at & 7) * 8)) & np.uint64(0xFF))
    computed = crc8(
        words,
        length,
        at,
        check.data_id,
        tables[check.crc_table],
        check.crc_init,
        check.crc_xor,
    )
    return int(received), int(computed)


@kernel
def counter_step(check: Any, received: int) -> int:
    """Return by how much the alive counter rose since the last frame (1 at the first)."""
    if check.seen == 0:
        return 1
    return int((received - check.last_counter) % check.modulo)


@dataclass(frozen=True)
class CheckInstance:
    """The configured communication checks of one message of a bus."""

    params: Params
    bus: int = 0
    name: str = ""


def signals_of(check: CheckInstance, database: Database) -> list[SignalRef]:
    """Return the signals that a check needs decoded."""
    p = check.params
    try:
        database.message(p.message)
        if p.counter is None:
            return []
        database.signal(p.message, p.counter.signal)
    except InputError as error:
        raise InputError(error.message, key=f'check of "{p.message}"', value=error.value) from error
    return [SignalRef(check.bus, p.message, p.counter.signal)]


def fill(row: Any, check: CheckInstance, plan: DecodePlan, database: Database, first_fault: int) -> list[FaultSlot]:
    """Fill one row of checks; returns the faults it can report, in order."""
    p = check.params
    message = database.message(p.message)
    asked = (
        p.timeout_ms is not None,
        p.counter is not None,
        p.crc is not None,
        p.length,
        p.value and bool(plan.messages[plan.message(check.bus, p.message)]["floats"]),
    )
    slots: list[FaultSlot] = []
    for kind, wanted in enumerate(asked):
        row["fault"][kind] = first_fault + len(slots) if wanted else -1
        if wanted:
            fault = p.fault_of(kind)
            slots.append(FaultSlot(f"{check.name}.{fault.name}", fault, check.bus))
    row["bus"] = check.bus
    row["length"] = message.length
    row["timeout_ns"] = round((p.timeout_ms or 0) * 1e6)
    row["deadline_ns"] = NEVER
    if p.counter is not None:
        signal = database.signal(p.message, p.counter.signal)
        row["counter"] = plan.position(check.bus, p.message, p.counter.signal)
        row["modulo"] = 1 << signal.length
        row["max_step"] = p.counter.max_step
    if p.crc is not None:
        signal = database.signal(p.message, p.crc.signal)
        big = signal.byte_order == "big_endian"
        if signal.length != 8 or signal.start % 8 != (7 if big else 0):
            raise InputError(
                "a CRC signal has 8 bits on a byte boundary",
                key=f"{p.message}.{p.crc.signal}",
                value=f"start {signal.start}, length {signal.length}",
            )
        algorithm = ALGORITHMS[p.crc.algorithm]
        row["crc_byte"] = signal.start // 8
        row["data_id"] = -1 if p.crc.data_id is None else p.crc.data_id
        row["crc_table"] = list(ALGORITHMS).index(p.crc.algorithm)
        row["crc_init"], row["crc_xor"] = algorithm.init, algorithm.xorout
    return slots
