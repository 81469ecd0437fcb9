"""A test drive as a TOML file: virtual ECUs, faults with their times, the DTCs expected."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from gateway.errors import InputError, nearest
from gateway.faults.settings import DtcText
from gateway.resources import shipped
from gateway.tomlfile import StrictModel, load
from gateway.vecu.engine_params import EngineParams, PulseFault
from gateway.vecu.linear_params import LinearFault, LinearParams
from gateway.vecu.pedal_params import PedalParams, SensorFault
from gateway.vecu.steering_faults import SteeringFault
from gateway.vecu.steering_params import SteeringParams
from gateway.vecu.truck_params import TruckFault, TruckParams


def _type(ecu: Any) -> str:
    """Return the type of an ECU; without one it is an engine."""
    return str(ecu.get("type", "engine") if isinstance(ecu, dict) else ecu.type)


Ecu = Annotated[
    Annotated[EngineParams, Tag("engine")]
    | Annotated[PedalParams, Tag("pedal")]
    | Annotated[SteeringParams, Tag("steering")]
    | Annotated[LinearParams, Tag("linear")]
    | Annotated[TruckParams, Tag("hybrid_truck")],
    Discriminator(
        _type,
        custom_error_type="ecu_type",
        custom_error_message="the types are engine, pedal, steering, linear, hybrid_truck",
    ),
]
EcuFault = Annotated[
    PulseFault | SensorFault | SteeringFault | LinearFault | TruckFault,
    Field(discriminator="kind"),
]
#: Which faults an ECU of a type can have.
_FAULTS: dict[str, type[StrictModel]] = {
    "engine": PulseFault,
    "pedal": SensorFault,
    "steering": SteeringFault,
    "linear": LinearFault,
    "hybrid_truck": TruckFault,
}


class WireFault(StrictModel):
    """A fault between an ECU and the gateway."""

    kind: Literal["lost", "corrupted", "late", "duplicated", "short", "silent"]
    message: str = Field(
        "*",
        description="name of a message of the configuration, identifier in hex (0x700), or * for all",
    )
    from_s: float = Field(0.0, ge=0, description="[s]")
    to_s: float | None = Field(None, description="[s]; default: the end")
    probability: float = Field(1.0, gt=0, le=1, description="that a frame is concerned")
    delay_ms: float = Field(30.0, gt=0, description="of a late frame [ms]")

    @model_validator(mode="after")
    def _times(self) -> WireFault:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError("to_s must lie after from_s")
        return self


class Expectation(StrictModel):
    """A DTC that the drive must cause, or must not."""

    dtc: DtcText
    after_s: float = Field(0.0, ge=0, description="not set before [s]")
    by_s: float | None = Field(None, gt=0, description="set not later than [s]; default: the end")
    healed_by_s: float | None = Field(None, gt=0, description="testFailed gone again by [s]")
    absent: bool = Field(False, description="must never be set")


class Scenario(StrictModel):
    """A test drive."""

    name: str
    description: str = ""
    duration_s: float = Field(gt=0, le=86400, description="[s]")
    seed: int = Field(1, ge=0)
    config: Path = Field(Path("../gateway.toml"), description="relative to the scenario")
    ecu: tuple[Ecu, ...] = Field(min_length=1)
    fault: tuple[EcuFault, ...] = ()
    wire: tuple[WireFault, ...] = ()
    expect: tuple[Expectation, ...] = ()
    unexpected: Literal["fail", "allow"] = Field("fail", description="DTCs that no line expects")

    @model_validator(mode="after")
    def _names_fit(self) -> Scenario:
        names = [ecu.name for ecu in self.ecu]
        if len(set(names)) != len(names):
            raise ValueError(f"two ECUs share a name: {', '.join(names)}")
        for fault in self.fault:
            if fault.ecu not in names:
                raise ValueError(f"no ECU {fault.ecu!r}; there are {', '.join(names)}")
            ecu = self.ecu[names.index(fault.ecu)]
            if type(fault) is not _FAULTS[ecu.type]:
                raise ValueError(f"ECU {ecu.name!r} is of type {ecu.type}: it has no {fault.kind}")
            if isinstance(fault, SensorFault) and isinstance(ecu, PedalParams):
                most = len(ecu.sensors)
                if max(fault.channel) > most:
                    raise ValueError(f"ECU {ecu.name!r} has no channel {max(fault.channel)}")
            if isinstance(fault, LinearFault) and isinstance(ecu, LinearParams):
                acts = fault.kind.startswith("actuator")
                count = ecu.plant.inputs if acts else ecu.plant.outputs
                if fault.place > count:
                    raise ValueError(
                        f"ECU {ecu.name!r} has no place {fault.place} for {fault.kind}"
                    )
        return self


def load_scenario(path: Path) -> Scenario:
    """Read a scenario; paths in it become relative to its folder.

    Raises:
        InputError, InputErrors: the file cannot be read, or a key is wrong.
    """
    scenario = load(path, Scenario)
    ecus = tuple(
        ecu.model_copy(update={"database": _found(path, k, ecu.database)})
        if isinstance(ecu, LinearParams) and ecu.database is not None
        else ecu
        for k, ecu in enumerate(scenario.ecu)
    )
    return scenario.model_copy(update={"config": path.parent / scenario.config, "ecu": ecus})


def _found(scenario: Path, place: int, database: Path) -> Path:
    """Return the path of an ECU's database: beside the scenario, else among the shipped."""
    beside = scenario.parent / database
    if beside.exists():
        return beside
    try:
        return shipped(str(database))
    except InputError:
        known = sorted(f"dbc/{path.name}" for path in shipped("dbc").glob("*.dbc"))
        raise InputError(
            f"no such file beside the scenario, and the gateway comes with {', '.join(known)} only"
            f"{nearest(str(database), known)}",
            file=scenario,
            key=f"ecu[{place}].database",
            value=str(database),
        ) from None
