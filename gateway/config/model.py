"""The gateway's configuration: one TOML file, strict, overridden by environment variables.

``GATEWAY_MEMORY__PATH=/var/lib/gateway/faults.sqlite`` overrides ``[memory] path``: prefix
``GATEWAY_``, two underscores between levels. Lists (buses, monitors) are set in the file only.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from gateway.bus.ring import RingParams
from gateway.bus.uri import channel_of, parse_uri
from gateway.common.plugins import importable
from gateway.common.tomlfile import StrictModel, input_errors, load, read_toml, validate
from gateway.engine.checks import bus_health, communication
from gateway.engine.checks.clock_health import ClockParams
from gateway.errors import InputError, InputErrors, nearest
from gateway.faults.recorder import RecorderParams
from gateway.faults.settings import POWER, CycleSettings, FaultOverride
from gateway.monitors.contract import Monitor, MonitorParams
from gateway.monitors.registry import MONITORS
from gateway.servers.diagnostic_address import share_address
from gateway.servers.dtc_frame import DtcFrameParams
from gateway.servers.identifiers import DidParams, check_unique
from gateway.servers.j1939.params import J1939Params
from gateway.servers.obd.params import ObdParams
from gateway.servers.uds.params import UdsParams


class BusConfig(StrictModel):
    """One CAN bus: where it is, how its frames are read, which messages are watched."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", description="how other parts refer to it")
    uri: str = Field(description="socketcan:vcan0, loopback:127.0.0.1:29536, virtual:name, ...")
    database: tuple[Path, ...] = Field(
        (), description="DBC, KCD, SYM or ARXML files; relative to this configuration"
    )
    match: Literal["id", "pgn"] = Field(
        "id", description="pgn: extended identifiers match by J1939 PGN"
    )
    check: tuple[communication.Params, ...] = Field((), description="communication checks")
    health: bus_health.Params = Field(
        bus_health.Params(), description="bus-off, error passive, errors, interface lost, overflow"
    )

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


class MemoryConfig(StrictModel):
    """The fault memory."""

    path: Path = Field(
        Path("faults.sqlite"), description="SQLite file; relative to the work folder"
    )
    entries: int | None = Field(
        None, ge=1, le=10_000, description="entries there is room for; default: for every fault"
    )
    watched: bool = Field(
        True,
        description="false: no DTC when it cannot be written, or was damaged; log, events and counters"
        " tell it in any case",
    )
    recording: RecorderParams | None = Field(
        None, description="frames kept around each failure; none: nothing is recorded"
    )


class OutputConfig(StrictModel):
    """How faults leave the gateway."""

    dtc_frame: DtcFrameParams | None = Field(None, description="DTC message on a bus")
    uds: UdsParams | None = Field(None, description="UDS server (ISO 14229-1) on ISO-TP")
    obd: ObdParams | None = Field(None, description="OBD server (SAE J1979) on ISO-TP")
    j1939: J1939Params | None = Field(None, description="J1939 diagnostic messages (J1939-73)")


class CatalogueFile(StrictModel):
    """A catalogue of faults in a file of its own."""

    fault: dict[str, FaultOverride] = Field(default_factory=dict)
    did: tuple[DidParams, ...] = ()


#: What a variable of the environment begins with that overrides the file, and what stands between its levels.
_PREFIX, _BETWEEN = "GATEWAY_", "__"


class Config(StrictModel):
    """A whole gateway."""

    name: str = "gateway"
    bus: tuple[BusConfig, ...] = Field(min_length=1)
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
    clock: ClockParams = Field(ClockParams(), description="the wall clock that stamps frames")
    memory: MemoryConfig = MemoryConfig()
    output: OutputConfig = OutputConfig()
    record: RingParams | None = Field(
        None, description="an always-on recording of all frames; none: nothing is recorded"
    )

    def bus_index(self, name: str | None) -> int:
        """Return the index of a bus.

        Raises:
            InputError: no bus of that name, or none named while there are several.
        """
        names = [bus.name for bus in self.bus]
        if name is None and len(names) == 1:
            return 0
        if name not in names:
            raise InputError(f"the buses are {', '.join(names)}", value=name or "(no bus named)")
        return names.index(name)

    def diagnostic_address_is_shared(self) -> bool:
        """Tell whether the UDS and the OBD server have one address.

        Raises:
            InputError: they share some of their identifiers, but not all.
        """
        uds, obd = self.output.uds, self.output.obd
        if uds is None or obd is None:
            return False
        same_bus = self.bus_index(uds.bus) == self.bus_index(obd.bus)
        return share_address(uds, obd, same_bus=same_bus)


def channels_of(config: Config, maps: Sequence[str] = ()) -> dict[str, int] | None:
    """Return which names in a log stand for which bus; None: there is one bus, and all is on it.

    Args:
        config: the configuration.
        maps: further names, ``"channel=bus"`` each. With one bus, only these and its own names are on it then.

    Raises:
        InputError: a map that is none, to a bus that is not there, or of a channel that has another.
    """
    if len(config.bus) == 1 and not maps:
        return None
    names = {}
    if len(config.bus) > 1:
        names = {
            f"can{k}": k for k in range(len(config.bus))
        }  # as our logs call buses without a name
        names |= {str(k): k for k in range(len(config.bus))}
    for k, bus in enumerate(config.bus):
        names |= {bus.name: k, bus.channel: k}
    known = [bus.name for bus in config.bus]
    joined: dict[str, int] = {}
    for text in maps:
        channel, equals, name = text.rpartition("=")
        if not equals or not channel:
            raise InputError("channel=bus, e.g. vcan7=chassis", key="--map", value=text)
        if name not in known:
            hint = nearest(name, known)
            raise InputError(f"the buses are {', '.join(known)}{hint}", key="--map", value=text)
        index = known.index(name)
        if joined.setdefault(channel, index) != index:
            raise InputError("this channel is joined to another bus", key="--map", value=text)
    return names | joined


def monitor_of(entry: MonitorConfig, key: str = "") -> tuple[Monitor[Any], MonitorParams]:
    """Return the type and the parameters of a configured monitor.

    Args:
        entry: of the configuration.
        key: its key path there, for errors.

    Raises:
        InputError, InputErrors: no such type; wrong parameters.
    """
    try:
        monitor = MONITORS.get(entry.type)
        if monitor is None:
            known = sorted(MONITORS)
            text = f"the types are {', '.join(known)}{nearest(entry.type, known)}"
            raise InputError(text, value=entry.type)
    except InputError as error:
        raise InputError(
            error.message, file=error.file, key=f"{key}.type" if key else "type", value=entry.type
        ) from error
    return monitor, validate(dict(entry.model_extra or {}), monitor.params, None, key)


def _cross_check(config: Config) -> Iterator[InputError]:
    names = [bus.name for bus in config.bus]
    for kind, found in (("bus", names), ("monitor", [m.name for m in config.monitor])):
        for k, name in enumerate(found):
            if name in found[:k]:
                yield InputError("this name is taken", key=f"{kind}[{k}].name", value=name)
    for k, entry in enumerate(config.monitor):
        try:
            monitor_of(entry, f"monitor[{k}]")
        except InputErrors as errors:
            yield from errors.errors
        except InputError as error:
            yield error
        try:
            config.bus_index(entry.bus)
        except InputError as error:
            yield InputError(error.message, key=f"monitor[{k}].bus", value=error.value)
    for k, bus in enumerate(config.bus):
        watched = [check.message for check in bus.check]
        for j, message in enumerate(watched):
            if message in watched[:j]:
                yield InputError(
                    "this message has its checks already",
                    key=f"bus[{k}].check[{j}].message",
                    value=message,
                )
    for name in ("dtc_frame", "uds", "obd", "j1939"):
        output = getattr(config.output, name)
        if output is None:
            continue
        try:
            config.bus_index(output.bus)
        except InputError as error:
            yield InputError(error.message, key=f"output.{name}.bus", value=error.value)
    named = {bus.name for bus in config.bus}
    servers = [entry for entry in (config.output.uds, config.output.obd) if entry is not None]
    if all(entry.bus in named or (entry.bus is None and len(named) == 1) for entry in servers):
        try:
            config.diagnostic_address_is_shared()
        except InputError as error:
            yield error
    yield from check_unique(config.did)
    if POWER in config.cycle:
        yield InputError("this cycle is always there: the gateway's run", key=f"cycle.{POWER}")
    cycles = {POWER, *config.cycle}
    for fault, settings in config.fault.items():
        for key in ("cycle", "aging_cycle"):
            cycle = getattr(settings, key)
            if cycle is not None and cycle not in cycles:
                known = ", ".join(sorted(cycles))
                yield InputError(
                    f"the cycles are {known}", key=f'fault."{fault}".{key}', value=cycle
                )


def _with_catalogues(config: Config, folder: Path) -> Config:
    """Return the configuration with what its catalogue files say.

    Raises:
        InputErrors: a file that is wrong; a fault that two places set.
    """
    faults, dids = dict(config.fault), list(config.did)
    wrong = []
    for name in config.catalogue:
        file = folder / name
        try:
            found = load(file, CatalogueFile)
        except InputErrors as errors:
            wrong += errors.errors
            continue
        except InputError as error:
            wrong.append(error)
            continue
        wrong += [
            InputError("this fault is set elsewhere already", file=file, key=f'fault."{fault}"')
            for fault in found.fault
            if fault in faults
        ]
        faults |= found.fault
        dids += found.did
    if wrong:
        raise InputErrors(wrong)
    return config.model_copy(update={"fault": faults, "did": tuple(dids)})


def _environment_says_something() -> bool:
    """Tell whether a variable of the environment overrides a key of the configuration."""
    names = (name.upper() for name in os.environ)
    keys = {
        name.removeprefix(_PREFIX).split(_BETWEEN)[0] for name in names if name.startswith(_PREFIX)
    }
    return any(name.upper() in keys for name in Config.model_fields)


@cache
def _with_environment() -> type[Config]:
    """Return the configuration's model with the environment before the file."""
    from pydantic_settings import (  # noqa: PLC0415 - slow to load
        BaseSettings,
        PydanticBaseSettingsSource,
        SettingsConfigDict,
    )

    class Settings(Config, BaseSettings):
        model_config = SettingsConfigDict(env_prefix=_PREFIX, env_nested_delimiter=_BETWEEN)

        @classmethod
        def settings_customise_sources(
            cls,
            settings_cls: type[BaseSettings],
            init_settings: PydanticBaseSettingsSource,
            env_settings: PydanticBaseSettingsSource,
            dotenv_settings: PydanticBaseSettingsSource,
            file_secret_settings: PydanticBaseSettingsSource,
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            return env_settings, init_settings

    return Settings


def _overridden(data: dict[str, Any], path: Path) -> Config:
    """Return a configuration with what the environment overrides."""
    from pydantic_settings import SettingsError  # noqa: PLC0415 - slow to load

    try:
        return _with_environment()(**data)
    except SettingsError as error:  # a variable that is no JSON where a table belongs
        text = f"the environment: {error}: {error.__cause__ or 'not readable'}"
        raise InputError(text, file=path) from error


def load_config(path: Path) -> Config:
    """Read a configuration; relative database paths become relative to its folder.

    Raises:
        InputError: the file cannot be read, or is not TOML.
        InputErrors: every key that is wrong.
    """
    data: dict[str, Any] = read_toml(path)
    try:
        config = _overridden(data, path) if _environment_says_something() else Config(**data)
    except ValidationError as error:
        raise input_errors(error, path, data=data, model=Config) from error
    folder = path.parent
    config = _with_catalogues(config, folder)
    if any(":" in entry.type for entry in config.monitor):
        importable(folder)
    wrong = [error.within(path) for error in _cross_check(config)]
    if wrong:
        raise InputErrors(wrong)
    buses = tuple(
        bus.model_copy(update={"database": tuple(folder / file for file in bus.database)})
        for bus in config.bus
    )
    return config.model_copy(update={"bus": buses})


def schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration, with every monitor's parameters."""
    document = Config.model_json_schema()
    document["$defs"]["MonitorConfig"]["anyOf"] = [
        {
            "properties": {
                "type": {"const": name},
                **monitor.params.model_json_schema().get("properties", {}),
            }
        }
        for name, monitor in sorted(MONITORS.described().items())
        if not isinstance(monitor, InputError)
    ]
    return document
