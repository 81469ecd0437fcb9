"""Settings of an ECU that is asked: the tables ``[[ecu]]`` and ``[bus.ask]`` of a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from gateway.engine.checks.message import Params as CheckParams
from gateway.faults.settings import ConditionSettings, DtcText
from gateway.isotp.addressing import AddressingParams
from gateway.j1939.frame import REQUEST, pgn_bytes
from gateway.monitors.contract import Debounce, Fault
from gateway_fdi.common.tomlfile import StrictModel

#: Services of requests that read values; all others have no layout.
READ_SERVICES = (0x01, 0x06, 0x09, 0x21, 0x22)
#: Services whose identifier has two bytes; those of others have one.
TWO_BYTES = (0x22, 0x2A, 0x2E, 0x2F, 0x31)
#: Service of classic OBD -> first identifier of its page in OBD on UDS (SAE J1979-2; ISO 14229-1, Annex C.1).
PAGES = {0x01: 0xF400, 0x06: 0xF600, 0x09: 0xF800}
#: First byte of a request for a parameter group in a schedule: no service of UDS or OBD has this number.
MARK = REQUEST >> 8
#: Services that only read DTCs.
DTC_SERVICES = (0x19, 0x03, 0x07, 0x0A)
#: Protocols: UDS, classic OBD (SAE J1979), OBD on UDS (SAE J1979-2), the one of these two that an ECU answers.
UDS, OBD, ON_UDS, AUTO = "uds", "obd", "obd_on_uds", "auto"
#: Events on which a value is read: the start, that its conditions become met, that a DTC came.
START, WHEN, DTC = "start", "when", "dtc"
#: Least time between two requests on an event [ms].
_EVENT_MS = 1000.0
#: Services of OBD that read values: PIDs, results of monitors, infotypes.
_OBD_SERVICES = tuple(PAGES)
#: DTC of another ECU, as the vehicle's memory has it; without a failure type it is any.
_CODE = r"^([PCBU][0-3][0-9A-F]{3}(-[0-9A-F]{2})?|SPN \d+ FMI \d+)$"


def request_name(service: int, identifier: int) -> str:
    """Return a request as hexadecimal digits: 22F190, 010C."""
    return f"{service:02X}{identifier:0{4 if service in TWO_BYTES else 2}X}"


class ReadParams(StrictModel):
    """A value that is read again and again."""

    did: int | None = Field(None, ge=0, le=0xFFFF, description="data identifier (0x22)")
    pid: int | None = Field(None, ge=0, le=0xFF, description="PID of current data (OBD 0x01)")
    pgn: int | None = Field(
        None, ge=0, le=0x3FFFF, description="J1939: parameter group; its messages are the bus's own"
    )
    service: int | None = Field(
        None, description="0x01, 0x06, 0x09, 0x21 or 0x22: with identifier, instead of did and pid"
    )
    identifier: int | None = Field(None, ge=0, le=0xFFFF, description="that the service reads")
    every_ms: float | None = Field(
        None, ge=10, le=86_400_000, description="time between two requests [ms]; with on: the least, default 1000"
    )
    on: str | None = Field(
        None, pattern="^(start|when|dtc)$",
        description="not by time: once, after the start; each time that `when` is met; that a DTC came, of the"
        " ECU or of ours",
    )  # fmt: skip
    when: tuple[ConditionSettings, ...] = Field((), description="only while all of these are met, by fresh values")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.every_ms is None and self.on is None) or (self.every_ms is not None and self.on == START):
            raise ValueError('give every_ms, or on = "start", "when" or "dtc"')
        if self.on == WHEN and not self.when:
            raise ValueError('on = "when" needs its conditions: when')
        given = [each is not None for each in (self.did, self.pid, self.pgn, self.service)]
        if sum(given) != 1 or (self.service is None) != (self.identifier is None):
            raise ValueError("give did, or pid, or pgn, or service with identifier")
        service, identifier = self.key
        if self.pgn is not None:
            return self
        if service not in READ_SERVICES:
            known = ", ".join(f"0x{each:02X}" for each in READ_SERVICES)
            raise ValueError(f"service 0x{service:02X} is not read by schedule; only {known}")
        if service not in TWO_BYTES and identifier > 0xFF:
            raise ValueError(f"service 0x{service:02X} has identifiers up to 0xFF, not 0x{identifier:X}")
        return self

    @property
    def key(self) -> tuple[int, int]:
        """Service and identifier; of a parameter group its number."""
        if self.pgn is not None:
            return MARK, self.pgn
        if self.did is not None:
            return 0x22, self.did
        if self.pid is not None:
            return 0x01, self.pid
        return self.service or 0, self.identifier or 0

    @property
    def rate(self) -> str:
        """How often it is read, for people."""
        conditions = f" while {' and '.join(one.signal for one in self.when)} are met" if self.when else ""
        return f"on {self.on}{conditions}" if self.on else f"every {self.every_ms:g} ms{conditions}"

    @property
    def apart_ms(self) -> float | None:
        """Least time between two requests [ms]; None: it is read once."""
        return None if self.on == START else self.every_ms or _EVENT_MS

    @property
    def is_obd(self) -> bool:
        """Whether it is of OBD, and asked as the ECU's protocol has it."""
        return self.key[0] in _OBD_SERVICES

    @property
    def name(self) -> str:
        """The request for people: 22F190, PGN 65260."""
        return request_name(*self.key) if self.pgn is None else f"PGN {self.pgn}"

    @property
    def request(self) -> bytes:
        """Bytes of the request, as the schedule has it."""
        if self.pgn is not None:
            return bytes([MARK]) + pgn_bytes(self.pgn)
        return bytes.fromhex(request_name(*self.key))


class DtcsParams(StrictModel):
    """How often an ECU is asked for its DTCs."""

    every_s: float = Field(ge=1, le=86_400, description="time between two requests [s]")
    protocol: str | None = Field(
        None, pattern="^(uds|obd|obd_on_uds|auto)$",
        description="uds: 0x19 02; obd: modes 03, 07, 0A; obd_on_uds: 0x19 42 and 55 of group 33; auto: what the ECU"
        " answers; default: auto if it is asked by OBD, uds else",
    )  # fmt: skip
    when: tuple[ConditionSettings, ...] = Field((), description="only while all of these are met, by fresh values")


class EcuFaultParams(StrictModel):
    """A fault of ours that stands for a DTC of an ECU: other settings are in ``[fault."ecu.name"]``."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", description="second part of its id")
    of: str = Field(
        pattern=r"^([PCBU][0-3][0-9A-F]{3}(-[0-9A-F]{2})?|SPN \d+ FMI \d+)$",
        description='DTC of the ECU: "P0A80-16", "P0A80"',
    )
    dtc: DtcText = Field(description="DTC of ours")
    description: str = Field("another ECU reports a DTC", min_length=1, description="one line for people")
    remedy: str = Field("", description="what to do about it, for people; default: by its failure type")

    @property
    def fault(self) -> Fault:
        """The fault as the engine knows it: each answer qualifies."""
        return Fault(self.name, self.dtc, self.description, (), Debounce(jump_down=True), self.remedy)


class AskParams(StrictModel):
    """How a bus is asked."""

    requests_per_s: float = Field(10.0, gt=0, le=1000, description="most requests a second, of all ECUs of the bus")


class EcuParams(AddressingParams):
    """An ECU that is asked, or whose answers to others are heard."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", description="how the rest refers to it")
    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    protocol: str = Field(
        AUTO, pattern="^(auto|obd|obd_on_uds)$",
        description="of pid and dtcs: obd (SAE J1979), obd_on_uds (SAE J1979-2), auto: what the ECU answers",
    )  # fmt: skip
    fd: bool = Field(False, description="it is asked in CAN FD frames; its answers are heard in either kind")
    signals: tuple[Path, ...] = Field((), description="layouts of its answers: DBC, OBDb, ...; relative to this file")
    read: tuple[ReadParams, ...] = Field((), description="values that are read again and again")
    dtcs: DtcsParams | None = Field(None, description="its DTCs are read; none: they are not")
    check: tuple[CheckParams, ...] = Field((), description="checks of its answers, as of messages of a bus")
    fault: tuple[EcuFaultParams, ...] = Field((), description="faults of ours that stand for DTCs of it")
    p2_ms: float = Field(200, ge=10, le=10_000, description="how long its answer is waited for [ms]")
    p2_star_ms: float = Field(5000, ge=10, le=60_000, description="the same after it said that it needs longer [ms]")

    @model_validator(mode="after")
    def _reads(self) -> Self:
        seen: set[tuple[int, int]] = set()
        for read in self.read:
            if read.key in seen:
                raise ValueError(f"{read.name} is read twice")
            if read.pgn is not None and self.address is None:
                raise ValueError(f"{read.name}: give the ECU's J1939 address: address")
            seen.add(read.key)
        return self

    @property
    def asks(self) -> bool:
        """Whether it is asked for anything; else its answers to others are heard."""
        return bool(self.read) or self.dtcs is not None

    @property
    def dtc_protocol(self) -> str:
        """Protocol by which its DTCs are read."""
        by_obd = "protocol" in self.model_fields_set or any(read.is_obd for read in self.read)
        given = None if self.dtcs is None else self.dtcs.protocol
        return given or (AUTO if by_obd else UDS)

    @property
    def finds_protocol(self) -> bool:
        """Whether it is found which protocol of OBD it answers."""
        asked = any(read.is_obd for read in self.read) or (self.dtcs is not None and self.dtc_protocol == AUTO)
        return self.protocol == AUTO and asked
