"""The keys of a configuration: one pydantic model a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    create_model,
    field_validator,
    model_validator,
)

from gateway.bus.ring import RingParams
from gateway.bus.uri import channel_of, parse_uri
from gateway.config.ecu import AskParams, EcuParams
from gateway.engine.checks import bus_health, message
from gateway.engine.checks.clock_health import ClockParams
from gateway.engine.depends.params import DiagnosisParams
from gateway.faults.external_faults import ReportParams
from gateway.faults.fleet import FleetParams
from gateway.faults.recorder import RecorderParams
from gateway.faults.settings import ConditionSettings, CycleSettings, FaultOverride
from gateway.faults.usage import UsageParams
from gateway.isotp.params import IsoTpParams
from gateway.servers.access import AccessParams, Needs, needs_of
from gateway.servers.diagnostic_address import share_address
from gateway.servers.dtc_frame import DtcFrameParams
from gateway.servers.identifiers import DidParams
from gateway.servers.section import IsotpSection, Section, usable
from gateway.servers.types import SERVERS, Server
from gateway.servers.uds.params import UdsParams
from gateway_fdi.common.tomlfile import StrictModel, validate
from gateway_fdi.errors import InputError, nearest, under


class DatabaseOfBus(StrictModel):
    """One bus of a database file that has several."""

    file: Path = Field(description="DBC, KCD, SYM or ARXML file")
    bus: str = Field(min_length=1, description="name of the bus in the file")


def _path(value: Any) -> Any:
    if isinstance(value, dict):
        of = DatabaseOfBus.model_validate(value)
        return of.file.with_name(f"{of.file.name}#{of.bus}")
    return value


DatabasePath = Annotated[Path, BeforeValidator(_path, json_schema_input_type=Path | DatabaseOfBus)]


class BusConfig(StrictModel):
    """One CAN bus: where it is, how its frames are read, which messages are watched."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", description="how other parts refer to it")
    uri: str = Field(description="socketcan:vcan0, loopback:127.0.0.1:29536, virtual:name, ...")
    database: tuple[DatabasePath, ...] = Field(
        (),
        description="DBC, KCD, SYM or ARXML files, relative to this configuration; of a file of several buses one of"
        ' them: { file = "car.kcd", bus = "Motor" }, or "car.kcd#Motor"',
    )
    match: Literal["id", "pgn"] = Field("id", description="pgn: extended identifiers match by J1939 PGN")
    bitrate: int | None = Field(None, ge=1000, le=1_000_000, description="nominal bit rate [bit/s]; for the bus load")
    data_bitrate: int | None = Field(
        None, ge=1000, le=20_000_000, description="bit rate of CAN FD's data phase [bit/s]; for the bus load"
    )
    check: tuple[message.Params, ...] = Field((), description="communication checks")
    codes: Literal["same", "own"] = Field(
        "same",
        description="base codes of checks that give none: same: U0100 and U0401 for each; own: U01xx, U02xx and U04xx, "
        "U05xx made of the message's name; gateway check lists them",
    )
    health: bus_health.Params = Field(
        bus_health.Params(), description="bus-off, error passive, errors, interface lost, overflow"
    )

    ask: AskParams = Field(AskParams(), description="how its ECUs are asked ([[ecu]])")
    dm1: bool = Field(False, description="J1939: DTCs that other ECUs broadcast (DM1) are kept, too")
    listen_only: bool = Field(False, description="nothing is sent on it, and no ECU of it is asked")

    @field_validator("uri")
    @classmethod
    def _uri_can_be_opened(cls, uri: str) -> str:
        try:
            parse_uri(uri)
        except InputError as error:
            raise ValueError(error.message) from error
        return uri

    @property
    def channel(self) -> str:
        """Name of the bus in logs: that of its interface, as can-utils writes it, else its own."""
        return channel_of(self.uri) if self.uri.startswith("socketcan:") else self.name


class MonitorConfig(BaseModel):
    """One monitor; keys beyond these are the parameters of its type."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", description="first part of its fault ids")
    type: str = Field(description="type of the monitor")
    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    priority: int = Field(0, description="order among the monitors of one message, 0 first")
    send: bool | str = Field(
        False,
        description="send its own message (angle, voted value, ...) on its bus; or the name of"
        " another message with the same signals",
    )
    signals: dict[str, str] = Field(
        default_factory=dict,
        description='default "Message.Signal" = your "Message.Signal", or "bus.Message.Signal"',
    )
    trusted: bool = Field(
        False,
        description="the indices of its kernel are not checked, if its package says the same (docs/monitors.md)",
    )
    _folder: Path = PrivateAttr(Path())

    @property
    def folder(self) -> Path:
        """Folder of the configuration, from which the files that it names are looked for."""
        return self._folder

    def lie_in(self, folder: Path) -> None:
        """Say which folder the configuration lies in."""
        self._folder = folder


class MemoryConfig(StrictModel):
    """The fault memory."""

    path: Path = Field(Path("faults.sqlite"), description="SQLite file; relative to the work folder")
    entries: int | None = Field(
        None, ge=1, le=10_000, description="entries there is room for; default: for every fault"
    )
    watched: bool = Field(
        True,
        description="false: no DTC when it cannot be written, was damaged, or the gateway died repeatedly; log, events"
        " and counters tell it in any case",
    )
    tell: Literal["stored", "first"] = Field(
        "stored",
        description="first: a DTC is told and sent at once, as not stored; an event tells when it is: a power cut"
        " between the two loses it",
    )
    symptoms: Literal["keep", "hold"] = Field(
        "keep", description="hold: a fault that only shows a proven cause is stored, but not confirmed"
    )
    recording: RecorderParams | None = Field(
        None, description="frames kept around each failure; none: nothing is recorded"
    )


class ServerConfig(BaseModel):
    """A server of another package; keys beyond these are the parameters of its type."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", description="for people")
    type: str = Field(description="type of the server, or module:NAME")
    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")


class PowerConfig(StrictModel):
    """When the vehicle is awake, and its supply good: senders that are silent otherwise are not at fault.

    Conditions count by the last value that came, also if its message comes no more; before the first one they are met.
    """

    awake: tuple[ConditionSettings, ...] = Field(
        (), description="the vehicle is awake while one of these is met (terminal 15, a network awake): timeouts count"
    )
    moving: tuple[ConditionSettings, ...] = Field(
        (), description="the vehicle moves while one of these is met: then it is not being switched off"
    )
    voltage: ConditionSettings | None = Field(
        None, description="the supply is good while this is met: only then do timeouts, and all that needs it, count"
    )
    suffers: tuple[str, ...] = Field(
        (), description="faults, or monitors with all of theirs, whose test results count only with a good supply"
    )

    @model_validator(mode="after")
    def _has_voltage(self) -> PowerConfig:
        if self.suffers and self.voltage is None:
            raise ValueError("suffers needs voltage")
        if any(one.rise for one in (*self.awake, *self.moving, *(() if self.voltage is None else (self.voltage,)))):
            raise ValueError("rise is for operation cycles, not for power")
        return self


class StatusConfig(StrictModel):
    """The socket on which a daemon shows what it does, and takes commands of who may open it."""

    socket: Path = Field(description="unix socket, made with mode 0600; relative to the work folder")
    readers: int = Field(8, ge=1, le=64, description="most readers at a time")


#: Tables of outputs that packages bring, by name.
_SECTIONS = usable()


class Outputs(StrictModel):
    """How faults leave the gateway."""

    dtc_frame: DtcFrameParams | None = Field(None, description="DTC message on a bus")
    uds: UdsParams | None = Field(None, description="UDS server (ISO 14229-1) on ISO-TP")

    @property
    def tables(self) -> dict[str, Any]:
        """Those that there are, by name."""
        found = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: params for name, params in found.items() if params is not None}

    @property
    def sections(self) -> dict[str, tuple[Section[Any], Any]]:
        """Those of packages that there are, and what each is."""
        return {name: (_SECTIONS[name], params) for name, params in self.tables.items() if name in _SECTIONS}

    @property
    def applications(self) -> dict[str, tuple[IsotpSection[Any], IsoTpParams]]:
        """Those of packages that are applications on ISO-TP."""
        return {name: (one, own) for name, (one, own) in self.sections.items() if isinstance(one, IsotpSection)}


if TYPE_CHECKING:
    OutputConfig = Outputs
else:
    OutputConfig = create_model(
        "OutputConfig",
        __base__=Outputs,
        __doc__=Outputs.__doc__,
        **{name: (one.params | None, Field(None, description=one.description)) for name, one in _SECTIONS.items()},
    )


class Config(StrictModel):
    """A whole gateway."""

    name: str = "gateway"
    bus: tuple[BusConfig, ...] = Field(min_length=1)
    ecu: tuple[EcuParams, ...] = Field((), description="ECUs that are asked; none: nothing is asked")
    monitor: tuple[MonitorConfig, ...] = ()
    fault: dict[str, FaultOverride] = Field(
        default_factory=dict,
        description='settings of single faults, e.g. [fault."crank.added_pulse"]',
    )
    catalogue: tuple[Path, ...] = Field(
        (), description="files with further tables fault and did; relative to this configuration"
    )
    did: tuple[DidParams, ...] = Field((), description="data identifiers")
    cycle: dict[str, CycleSettings] = Field(
        default_factory=dict,
        description='operation cycles that signals begin and end; "power" is always there',
    )
    power: PowerConfig = Field(PowerConfig(), description="when the vehicle is awake, and its supply good")
    diagnosis: DiagnosisParams = Field(
        DiagnosisParams(), description="weights of causes: priors, supplies and grounds that parts share"
    )
    clock: ClockParams = Field(ClockParams(), description="the wall clock that stamps frames")
    memory: MemoryConfig = MemoryConfig()
    output: OutputConfig = OutputConfig()
    server: tuple[ServerConfig, ...] = Field((), description="servers of other packages (docs/plugins.md)")
    access: AccessParams = Field(AccessParams(), description="who may intervene, and when")
    usage: UsageParams | None = Field(
        None, description="how the vehicle is used: distance, running time, performance ratios of monitors"
    )
    status: StatusConfig | None = Field(None, description="a unix socket for gateway serve and gateway watch")
    fleet: FleetParams | None = Field(None, description="the fleet that the car is in; none: nothing waits for one")
    report: ReportParams | None = Field(None, description="a unix socket on which other processes report test results")
    record: RingParams | None = Field(
        None, description="an always-on recording of all frames; none: nothing is recorded"
    )

    def bus_index(self, name: str | None) -> int:
        """Return the index of a bus.

        Raises:
            InputError: no bus of that name, or none named while there are several.
        """
        names = [bus.name for bus in self.buses]
        if name is None and len(self.bus) == 1:
            return 0
        if name not in names:
            text = f"the buses are {', '.join(names)}{nearest(name or '', names)}"
            raise InputError(text, value=name or "(no bus named)")
        return names.index(name)

    @property
    def answered(self) -> dict[int, list[int]]:
        """Indices of the ECUs of each bus that has some, or DM1: a bus of their answers for each, in this order."""
        found: dict[int, list[int]] = {k: [] for k, bus in enumerate(self.bus) if bus.dm1}
        for k, ecu in enumerate(self.ecu):
            names = [bus.name for bus in self.bus]
            if ecu.bus in names or (ecu.bus is None and len(names) == 1):
                found.setdefault(0 if ecu.bus is None else names.index(ecu.bus), []).append(k)
        return dict(sorted(found.items()))

    @property
    def buses(self) -> tuple[BusConfig, ...]:
        """The buses, then those of the answers of ECUs on them: ``answers:<bus>``, which nothing opens."""
        return (*self.bus, *(self._answers_of(self.bus[k], ecus) for k, ecus in self.answered.items()))

    def _answers_of(self, bus: BusConfig, ecus: list[int]) -> BusConfig:
        checks = tuple(check for k in ecus for check in self.ecu[k].check)
        name, health = f"answers:{bus.name}", bus_health.Params(watched=False)
        made = BusConfig(name="answers", uri="virtual:answers", check=checks, health=health, codes=bus.codes)
        return made.model_copy(update={"name": name, "uri": name})

    def key_of_check(self, bus: int, check: int) -> str:
        """Return the key of a check of a bus, by their indices."""
        if bus < len(self.bus):
            return f"bus[{bus}].check[{check}]"
        ecus = list(self.answered.values())[bus - len(self.bus)]
        keys = [f"ecu[{k}].check[{at}]" for k in ecus for at in range(len(self.ecu[k].check))]
        return keys[check]

    @property
    def servers(self) -> tuple[Server, ...]:
        """The servers of other packages.

        Raises:
            InputError, InputErrors: no such type; wrong parameters; no such bus.
        """
        made = []
        for k, entry in enumerate(self.server):
            kind = SERVERS.find(entry.type, f"server[{k}]")
            params = validate(dict(entry.model_extra or {}), kind.params, None, f"server[{k}]")
            with under(f"server[{k}].bus", entry.bus):
                made.append(Server(kind, params, entry.name, self.bus_index(entry.bus)))
        return tuple(made)

    @property
    def has_doors(self) -> bool:
        """Whether testers, readers, reporters or asked ECUs are heard, so that their bytes can make handling fail."""
        asked = (self.output.uds, self.status, self.report)
        others = bool(self.ecu or self.server or self.output.sections)
        return self.access.watched and (others or any(each is not None for each in asked))

    @property
    def access_rules(self) -> AccessParams:
        """The rules of access, with those that the UDS server's own table gives."""
        uds = self.output.uds
        return self.access if uds is None else self.access.model_copy(update=uds.rules)

    @property
    def security_levels(self) -> list[int]:
        """Security levels that there are."""
        return [] if self.output.uds is None else self.output.uds.levels

    @property
    def roles(self) -> list[str]:
        """Roles of testers that there are."""
        return [] if self.output.uds is None else self.output.uds.roles

    @property
    def needs(self) -> Needs:
        """Conditions of each intervention."""
        allowed = {
            what: allows
            for one, params in self.output.sections.values()
            for what, (_, allows) in one.allows(params).items()
        }
        return needs_of(self.access_rules, self.security_levels, allowed, self.roles)

    @property
    def j1939_addresses(self) -> list[tuple[int, int]]:
        """Addresses that outputs claim, each with the index of its bus."""
        found = [(params, one.j1939_address(params)) for one, params in self.output.sections.values()]
        return [(self.bus_index(params.bus), address) for params, address in found if address is not None]

    def address_is_shared(self, name: str) -> bool:
        """Return whether an application on ISO-TP has the address of the UDS server.

        Args:
            name: of its table.

        Raises:
            InputError: they share some of their identifiers, but not all.
        """
        uds, (_, other) = self.output.uds, self.output.applications[name]
        if uds is None:
            return False
        same_bus = self.bus_index(uds.bus) == self.bus_index(other.bus)
        return share_address(uds, other, name, same_bus=same_bus)
