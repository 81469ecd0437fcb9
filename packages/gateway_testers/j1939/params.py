"""Settings of the J1939 server."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from gateway_fdi.common.tomlfile import StrictModel
from gateway_testers.j1939.claim import NameParams

Lamp = Literal["malfunction", "stop", "warning", "protect"]


class FreezeFrameSpn(StrictModel):
    """One parameter of the expanded freeze frames (DM25), coded as J1939-71 has it."""

    spn: int = Field(ge=1, le=0x7FFFF, description="suspect parameter number")
    signal: str = Field(description='"Message.Signal" or "bus.Message.Signal"')
    length: int = Field(1, ge=1, le=4, description="bytes")
    scale: float = Field(1.0, gt=0, allow_inf_nan=False, description="signal's unit for one step")
    offset: float = Field(0.0, allow_inf_nan=False, description="value of a coded 0, signal's unit")

    def encode(self, value: float | None) -> bytes:
        """Code a value, low byte first; an unknown one is all ones, the rest is clipped to the valid range."""
        if value is None or not math.isfinite(value):
            return b"\xff" * self.length
        most = (0xFA << 8 * (self.length - 1)) | ((1 << 8 * (self.length - 1)) - 1)
        coded = round(min(max((value - self.offset) / self.scale, 0), most))
        return coded.to_bytes(self.length, "little")


#: A text of an identification; "*" ends each.
IdText = Annotated[str, StringConstraints(pattern=r"^[\x20-\x29\x2B-\x7E]{1,200}$")]
_Field = Annotated[str, StringConstraints(pattern=r"^[\x20-\x29\x2B-\x7E]{0,200}$")]


class ComponentParams(StrictModel):
    """Component identification (SAE J1939-71, PGN 65259)."""

    make: _Field = Field("", description="make, of up to five letters by the standard")
    model: _Field = Field("", description="model")
    serial: _Field = Field("", description="serial number")
    unit: _Field = Field("", description="unit number")


class J1939Params(StrictModel):
    """The J1939 server."""

    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    address: int = Field(0xF9, ge=0, le=253, description="source address it claims")
    name: NameParams = NameParams()
    cycle_ms: float = Field(1000.0, ge=100, le=60_000, allow_inf_nan=False, description="time between two DM1 [ms]")
    when_clear: bool = Field(True, description="send DM1 also while no DTC is active")
    lamps: tuple[Lamp, ...] = Field(
        ("malfunction", "stop", "warning", "protect"),
        description="lamps that there are; the others are shown as not available",
    )
    allow_clear: bool | None = Field(
        None, description="do DM3 and DM11, rather than refuse them; default: as access.j1939_clear says"
    )
    commanded_address: bool = Field(False, description="take another address when it is commanded (J1939-81)")
    vin: str | None = Field(None, pattern=r"^[A-HJ-NPR-Z0-9]{17}$", description="vehicle identification number")
    component: ComponentParams | None = Field(None, description="component identification")
    software: tuple[IdText, ...] = Field((), description="software identification; default: the gateway's version")
    calibration: str | None = Field(
        None, pattern=r"^[\x20-\x7E]{1,16}$", description="calibration identification, DM19"
    )
    calibration_check: int = Field(0, ge=0, le=0xFFFFFFFF, description="calibration verification number, DM19")
    obd_compliance: int = Field(5, ge=1, le=250, description="OBD compliance in DM5; 5: none")
    freeze_frame: tuple[FreezeFrameSpn, ...] = Field(
        (), description="parameters of the expanded freeze frames (DM24, DM25)"
    )

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        spns = [entry.spn for entry in self.freeze_frame]
        if len(set(spns)) != len(spns):
            raise ValueError("freeze_frame: two entries have one spn")
        return self
