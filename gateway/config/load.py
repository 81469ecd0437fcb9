"""A configuration's file: TOML, strict, with its catalogues, overridden by environment variables.

``GATEWAY_MEMORY__PATH=/var/lib/gateway/faults.sqlite`` overrides ``[memory] path``: prefix
``GATEWAY_``, two underscores between levels. Lists (buses, monitors) are set in the file only.
"""

from __future__ import annotations

import os
from collections.abc import Collection
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from gateway.common.calls import CALLS
from gateway.common.gc_pause import gc_paused
from gateway.common.trust import beside
from gateway.config.cross_check import cross_check
from gateway.config.model import Config
from gateway.faults.settings import FaultOverride
from gateway.servers.identifiers import DidParams
from gateway_fdi.common.log import get_logger
from gateway_fdi.common.resources import beside_or_shipped
from gateway_fdi.common.tomlfile import StrictModel, input_errors, load, read_toml
from gateway_fdi.errors import InputError, InputErrors, nearest


class CatalogueFile(StrictModel):
    """A catalogue of faults in a file of its own."""

    fault: dict[str, FaultOverride] = Field(default_factory=dict)
    did: tuple[DidParams, ...] = ()


#: Prefix of the variables of the environment that override the file, and the separator of their levels.
_PREFIX, _BETWEEN = "GATEWAY_", "__"
_ENVIRONMENT = "the environment"
#: Name of the call that puts the limits of a campaign into a configuration's tables.
LIMITS = "campaign_limits"

log = get_logger(__name__)


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
    """Return whether a variable of the environment overrides a key of the configuration.

    Raises:
        InputError: one of several levels names no table that there is.
    """
    keys = {name.upper() for name in Config.model_fields}
    named = {name: name.upper().removeprefix(_PREFIX).split(_BETWEEN) for name in os.environ if _is_ours(name)}
    for name, levels in named.items():
        if len(levels) > 1 and levels[0] not in keys:
            text = f"no table of the configuration is called {levels[0].lower()}{nearest(levels[0], keys)}"
            raise InputError(text, file=_ENVIRONMENT, key=name)
    return any(levels[0] in keys for levels in named.values())


def _is_ours(name: str) -> bool:
    return name.upper().startswith(_PREFIX)


def _of_environment(error: InputError) -> InputError:
    """Return an error of a key as one of the environment, if it comes from there and not from the file."""
    levels = (error.key or "").split(".")
    names = [_PREFIX + _BETWEEN.join(levels[:depth]).upper() for depth in range(len(levels), 0, -1)]
    given = {name.upper(): name for name in os.environ if _is_ours(name)}
    found = next((given[name] for name in names if name in given), None)
    return error if found is None else error.replace(file=_ENVIRONMENT, key=found)


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


def _overridden(data: dict[str, Any], path: Path | None) -> Config:
    """Return a configuration with what the environment overrides."""
    from pydantic_settings import SettingsError  # noqa: PLC0415 - slow to load

    try:
        return _with_environment()(**data)
    except SettingsError as error:  # a variable that is no JSON where a table belongs
        text = f"{error}: {error.__cause__ or 'not readable'}"
        raise InputError(text, file=_ENVIRONMENT) from error


def _with_limits(data: dict[str, Any]) -> dict[str, Any]:
    """Return a configuration's tables with the limits of a campaign, where it names their file."""
    fleet = data.get("fleet")
    if not isinstance(fleet, dict) or "limits" not in fleet:
        return data
    if LIMITS not in CALLS:  # a car must not be without diagnosis because of a campaign
        log.error("no installed package reads limits of a campaign; those of the configuration judge")
        return data
    made: dict[str, Any] = CALLS[LIMITS](data)
    return made


@gc_paused()
def load_config(path: str | Path, without: Collection[tuple[int, str]] = ()) -> Config:
    """Read a configuration; databases are those beside it, else shipped ones.

    Args:
        path: of the file.
        without: keys of monitors that are taken as if they were not there: the monitor's place, the key.

    Raises:
        InputError: the file cannot be read, or is not TOML.
        InputErrors: every key that is wrong.
    """
    path = Path(path)
    data: dict[str, Any] = _with_limits(read_toml(path))
    for place, key in without:
        data["monitor"][place].pop(key, None)
    return config_of(data, path)


def config_of(data: dict[str, Any], path: Path | None, folder: Path | None = None) -> Config:
    """Return the configuration that the tables of a file are.

    Args:
        data: the tables.
        path: of the file; None: they are of no file.
        folder: in which the files that they name lie; None: that of the file.

    Raises:
        InputErrors: every key that is wrong.
    """
    try:
        config = _overridden(data, path) if _environment_says_something() else Config(**data)
    except ValidationError as error:
        found = input_errors(error, path, data=data, model=Config).errors
        raise InputErrors([_of_environment(each) for each in found]) from error
    return placed(config, path, folder)


def placed(config: Config, path: Path | None, folder: Path | None = None) -> Config:
    """Return a configuration whose files are found, and whose tables go together; arguments as of :func:`config_of`.

    Raises:
        InputErrors: every key that is wrong.
    """
    if folder is None:
        folder = Path() if path is None else path.parent
    config = _with_catalogues(config, folder)
    for entry in config.monitor:
        entry.lie_in(folder)
    beside(folder)
    wrong = [error.within(path) for error in cross_check(config)]
    if wrong:
        raise InputErrors(wrong)
    buses = tuple(
        bus.model_copy(
            update={
                "database": tuple(beside_or_shipped(folder, file) for file in bus.database),
                "check": tuple(check.lie_in(folder) for check in bus.check),
            }
        )
        for bus in config.bus
    )
    ecus = tuple(
        ecu.model_copy(update={"signals": tuple(beside_or_shipped(folder, file) for file in ecu.signals)})
        for ecu in config.ecu
    )
    return _with_certificates(config.model_copy(update={"bus": buses, "ecu": ecus}), folder)


def _with_certificates(config: Config, folder: Path) -> Config:
    """Return the configuration with its certificates relative to its folder, too."""
    uds = config.output.uds
    if uds is not None and uds.authentication is not None:
        roots = tuple(folder / file for file in uds.authentication.roots)
        authentication = uds.authentication.model_copy(update={"roots": roots})
        uds = uds.model_copy(update={"authentication": authentication})
    others = {name: one.placed(params, folder) for name, (one, params) in config.output.sections.items()}
    return config.model_copy(update={"output": config.output.model_copy(update={"uds": uds, **others})})
