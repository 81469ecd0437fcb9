"""Addresses and transport of a diagnostic server on ISO-TP."""

from __future__ import annotations

from pydantic import Field

from gateway.bus.frames import EXTENDED
from gateway_fdi.common.tomlfile import StrictModel


class IsoTpParams(StrictModel):
    """Addresses and transport of a diagnostic server."""

    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    request: int = Field(0x7E0, ge=0, le=0x1FFFFFFF, description="identifier of physical requests")
    functional: int | None = Field(0x7DF, ge=0, le=0x1FFFFFFF, description="identifier of functional requests")
    response: int = Field(0x7E8, ge=0, le=0x1FFFFFFF, description="identifier of the answers")
    extended: bool | None = Field(None, description="29-bit identifiers; default: if one of them is above 0x7FF")
    fd: bool = Field(False, description="answers in CAN FD frames of up to 64 bytes")
    padding: int | None = Field(0xCC, ge=0, le=255, description="fills frames up; none: short ones")
    block_size: int = Field(0, ge=0, le=255, description="frames a tester may send in a row, 0: all")
    separation_ms: int = Field(0, ge=0, le=127, description="time between them [ms]")

    @property
    def flags(self) -> int:
        """Flag of its identifiers in a frame: EXTENDED or 0."""
        long = max(self.request, self.response, self.functional or 0) > 0x7FF
        return EXTENDED if self.extended or (self.extended is None and long) else 0

    def same_transport(self, other: IsoTpParams) -> bool:
        """Return whether another server has the same addresses and transport, on whichever bus."""
        names = IsoTpParams.model_fields.keys() - {"bus"}
        return all(getattr(other, name) == getattr(self, name) for name in names)
