"""The place of an ECU on a bus: its identifiers, and address bytes in its frames (ISO 15765-2, 10.3)."""

from __future__ import annotations

from typing import NamedTuple, Self

from pydantic import Field, model_validator

from gateway.bus.frames import EXTENDED
from gateway_fdi.common.tomlfile import StrictModel

#: Identifiers of functional requests, to all ECUs of a bus.
FUNCTIONAL = (0x7DF, EXTENDED | 0x18DB33F1)
#: A tester's address in normal fixed addressing, and usual in extended addressing.
TESTER = 0xF1


class EcuAddress(NamedTuple):
    """Identifiers of an ECU, with EXTENDED, and address bytes in its frames; None: there are none."""

    request: int
    response: int
    target: int | None
    tester: int | None


class AddressingParams(StrictModel):
    """The place of an ECU on a bus."""

    request: int | None = Field(None, ge=0, le=0x1FFFFFFF, description="identifier of requests to it")
    response: int | None = Field(None, ge=0, le=0x1FFFFFFF, description="identifier of its answers")
    extended: bool | None = Field(None, description="29-bit identifiers; default: if one of them is above 0x7FF")
    address: int | None = Field(
        None, ge=0, le=0xFF, description="normal fixed addressing, instead of request and response: 18DAxxF1, 18DAF1xx"
    )
    target: int | None = Field(
        None, ge=0, le=0xFF, description="extended addressing: its address, first byte of frames to it"
    )
    tester: int = Field(TESTER, ge=0, le=0xFF, description="extended addressing: first byte of frames from it")

    @model_validator(mode="after")
    def _addressed(self) -> Self:
        pair = (self.request is not None, self.response is not None)
        if any(pair) != all(pair) or all(pair) == (self.address is not None):
            raise ValueError("give request and response, or address")
        if self.address is not None and (self.extended is False or self.target is not None):
            raise ValueError("address is of 29-bit identifiers, without target")
        if self.extended is False and max(self.request or 0, self.response or 0) > 0x7FF:
            raise ValueError("identifiers above 0x7FF have 29 bits: extended = true")
        if self.place.request in FUNCTIONAL:
            raise ValueError("this request is to all ECUs: give the ECU's own, as 0x7E0 to 0x7E7 of OBD")
        if self.request is not None and self.request == self.response:
            raise ValueError("request and response are the same identifier")
        return self

    @property
    def place(self) -> EcuAddress:
        """Its identifiers and address bytes."""
        if self.address is not None:
            fixed = EXTENDED | 0x18DA0000
            return EcuAddress(fixed | self.address << 8 | TESTER, fixed | TESTER << 8 | self.address, None, None)
        request, response = self.request or 0, self.response or 0
        long = self.extended or (self.extended is None and max(request, response) > 0x7FF)
        flag = EXTENDED if long else 0
        return EcuAddress(request | flag, response | flag, self.target, None if self.target is None else self.tester)
