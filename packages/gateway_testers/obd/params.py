"""Settings of the OBD server."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from gateway.isotp.params import IsoTpParams
from gateway_fdi.common.tomlfile import StrictModel

#: Usual PIDs with one value: bytes, value of one step, value of a coded 0 (SAE J1979-DA).
STANDARD: dict[int, tuple[int, float, float]] = {
    0x04: (1, 100 / 255, 0.0),  # calculated load [%]
    0x05: (1, 1.0, -40.0),  # coolant temperature [degC]
    0x0A: (1, 3.0, 0.0),  # fuel pressure [kPa]
    0x0B: (1, 1.0, 0.0),  # intake manifold pressure [kPa]
    0x0C: (2, 0.25, 0.0),  # engine speed [rpm]
    0x0D: (1, 1.0, 0.0),  # vehicle speed [km/h]
    0x0E: (1, 0.5, -64.0),  # ignition advance [deg]
    0x0F: (1, 1.0, -40.0),  # intake air temperature [degC]
    0x10: (2, 0.01, 0.0),  # air mass flow [g/s]
    0x11: (1, 100 / 255, 0.0),  # throttle position [%]
    0x1F: (2, 1.0, 0.0),  # time since engine start [s]
    0x2C: (1, 100 / 255, 0.0),  # commanded EGR [%]
    0x2F: (1, 100 / 255, 0.0),  # fuel level [%]
    0x33: (1, 1.0, 0.0),  # barometric pressure [kPa]
    0x42: (2, 0.001, 0.0),  # control module voltage [V]
    0x43: (2, 100 / 255, 0.0),  # absolute load [%]
    0x45: (1, 100 / 255, 0.0),  # relative throttle position [%]
    0x46: (1, 1.0, -40.0),  # ambient temperature [degC]
    0x47: (1, 100 / 255, 0.0),  # absolute throttle position B [%]
    0x49: (1, 100 / 255, 0.0),  # accelerator pedal position D [%]
    0x4A: (1, 100 / 255, 0.0),  # accelerator pedal position E [%]
    0x4B: (1, 100 / 255, 0.0),  # accelerator pedal position F [%]
    0x4C: (1, 100 / 255, 0.0),  # commanded throttle actuator [%]
    0x5A: (1, 100 / 255, 0.0),  # relative accelerator pedal position [%]
    0x5C: (1, 1.0, -40.0),  # engine oil temperature [degC]
    0x5E: (2, 0.05, 0.0),  # engine fuel rate [L/h]
    0x61: (1, 1.0, -125.0),  # driver's demand torque [%]
    0x62: (1, 1.0, -125.0),  # actual engine torque [%]
    0x63: (2, 1.0, 0.0),  # engine reference torque [Nm]
}
#: PIDs that the server answers itself.
OWN = (0x01, 0x02, 0x1C, 0x41)


class PidParams(StrictModel):
    """One PID of modes 01 and 02: a signal, coded as J1979 has it."""

    id: int = Field(ge=0x03, le=0xFF, description="PID, e.g. 0x0C")
    signal: str = Field(description='"Message.Signal" or "bus.Message.Signal", in the unit of J1979')
    length: int | None = Field(None, ge=1, le=4, description="bytes; default: that of J1979")
    scale: float | None = Field(None, gt=0, allow_inf_nan=False, description="signal's unit for one step")
    offset: float | None = Field(None, allow_inf_nan=False, description="value of a coded 0, signal's unit")

    @model_validator(mode="after")
    def _coded(self) -> Self:
        if self.id % 0x20 == 0 or self.id in OWN:
            raise ValueError("the server answers this PID itself")
        given = (self.length, self.scale, self.offset)
        if self.id not in STANDARD and None in given:
            raise ValueError("not among the usual PIDs: give length, scale and offset")
        return self

    def encode(self, value: float | None) -> bytes:
        """Code a value; an unknown one is 0, as J1979 has no code for it; the rest is clipped."""
        length, scale, offset = STANDARD.get(self.id, (1, 1.0, 0.0))
        length = self.length or length
        scale = scale if self.scale is None else self.scale
        offset = offset if self.offset is None else self.offset
        coded = 0.0 if value is None or not math.isfinite(value) else (value - offset) / scale
        return round(min(max(coded, 0), (1 << (8 * length)) - 1)).to_bytes(length, "big")


class ObdParams(IsoTpParams):
    """The OBD server."""

    pid: tuple[PidParams, ...] = Field((), description="PIDs served from signals")
    vin: str | None = Field(None, pattern=r"^[A-HJ-NPR-Z0-9]{17}$", description="vehicle identification number")
    calibration: str | None = Field(None, pattern=r"^[\x20-\x7E]{1,16}$", description="calibration identification")
    calibration_check: int | None = Field(None, ge=0, le=0xFFFFFFFF, description="calibration verification number")
    ecu_name: str | None = Field(None, pattern=r"^[\x20-\x7E]{1,20}$", description="name of the control unit")
    standard: int = Field(5, ge=1, le=250, description="OBD standard it is made to (PID 1C); 5: none")

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        ids = [pid.id for pid in self.pid]
        if len(set(ids)) != len(ids):
            raise ValueError("pid: two entries have one id")
        return self
