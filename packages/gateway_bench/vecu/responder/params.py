"""Answers of an ECU to requests."""

from __future__ import annotations

import re
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from gateway.signals.protection.params import ProtectionParams
from gateway_bench.vecu.contract import EcuParams
from gateway_bench.vecu.responder.memory import StoredDtc
from gateway_bench.vecu.restbus.courses import Points, rising
from gateway_fdi.common.tomlfile import StrictModel

_PAIRS = re.compile(r"(?:[0-9A-Fa-f]{2}\s*)+")


def _hex(text: str) -> str:
    """Refuse what is no hex.

    Raises:
        ValueError: it is none.
    """
    if not _PAIRS.fullmatch(text.strip()):
        raise ValueError('bytes in hex: "62 F1 90 31"')
    return bytes.fromhex(text).hex()


def _request(text: str) -> str:
    """Refuse what is no request; one that ends with * is the begin of several.

    Raises:
        ValueError: it is none.
    """
    begin = text.strip().removesuffix("*")
    return _hex(begin) + ("*" if text.strip().endswith("*") else "")


Hex = Annotated[str, AfterValidator(_hex)]
Request = Annotated[str, AfterValidator(_request)]


class UdsValue(StrictModel):
    """A number that an ECU answers, and its course."""

    points: Points = Field(description="[[time s, number], ...], as the answer has it, linear between them")
    size: int = Field(1, ge=1, le=8, description="its bytes, most significant first")

    @model_validator(mode="after")
    def _rising(self) -> Self:
        rising("points", self.points)
        return self

    def at(self, t_ns: int) -> bytes:
        """Return its bytes at a time [ns]."""
        times, numbers = zip(*self.points, strict=True)
        number = round(float(np.interp(t_ns / 1e9, times, numbers)))
        return self.raw(number)

    def raw(self, number: int) -> bytes:
        """Return the bytes of a number, the nearest that they can carry."""
        return min(max(number, 0), (1 << 8 * self.size) - 1).to_bytes(self.size, "big")


class UdsStub(StrictModel):
    """A UDS server that knows the answers to some requests."""

    request: int = Field(ge=0, le=0x1FFFFFFF, description="identifier of requests")
    response: int = Field(ge=0, le=0x1FFFFFFF, description="identifier of answers")
    functional: int | None = Field(None, ge=0, le=0x1FFFFFFF, description="identifier of requests to all")
    extended: bool = Field(False, description="29 bits")
    answers: dict[Request, Hex] = Field(
        default_factory=dict, description='"22 F1 90" -> "62 F1 90 31 32"; "22*": all that begin so'
    )
    identifiers: dict[str, str] = Field(
        default_factory=dict, description='"F190" -> text, "0x.." bytes in hex, or "Message.Signal": read by 0x22'
    )
    values: dict[Hex, UdsValue] = Field(
        default_factory=dict, description='"01 05", "22 F4 05" -> number that goes on with time'
    )
    dtc: tuple[StoredDtc, ...] = Field((), description="its fault memory: 0x19, 0x14, and modes 03, 04, 07, 0A of OBD")
    protocol: Literal["obd", "obd_on_uds", "both"] = Field(
        "obd", description="of its fault memory: 19 01, 02, 0A and the modes; 19 42, 55 (SAE J1979-2); both"
    )
    delay_ms: float = Field(5.0, ge=0, le=60_000, allow_inf_nan=False, description="until it answers [ms]")

    @model_validator(mode="after")
    def _identifiers(self) -> Self:
        for name in self.identifiers:
            if not re.fullmatch(r"[0-9A-Fa-f]{4}", name):
                raise ValueError(f"identifiers.{name}: four digits in hex: F190")
        top = 0x1FFFFFFF if self.extended else 0x7FF
        for name in ("request", "response", "functional"):
            value = getattr(self, name)
            if value is not None and value > top:
                raise ValueError(f"{name}: 0x{value:X} has more than 11 bits: extended = true")
        return self


class Reply(ProtectionParams):
    """A message that is sent when another one has come."""

    on: str = Field(description="message that asks")
    when: str | None = Field(None, description='only if this holds of its signals: "Ask.Page == 2"')
    send: str = Field(description="message that answers")
    signals: dict[str, float] = Field(default_factory=dict, description="signal of the answer -> value")
    echo: dict[str, str] = Field(default_factory=dict, description='signal of the answer -> "Message.Signal" heard')
    delay_ms: float = Field(2.0, ge=0, le=60_000, allow_inf_nan=False, description="[ms]")


class ResponderParams(EcuParams):
    """An ECU that answers."""

    type: Literal["responder"]
    name: str = "responder"
    uds: UdsStub | None = None
    reply: tuple[Reply, ...] = ()

    @property
    def summary(self) -> str:
        """Its kind, for people."""
        known = 0 if self.uds is None else len({*self.uds.answers, *self.uds.identifiers, *self.uds.values})
        return f"answers {known} UDS requests, {len(self.reply)} messages"

    @model_validator(mode="after")
    def _something(self) -> Self:
        if self.uds is None and not self.reply:
            raise ValueError("it answers nothing: give [ecu.uds], or [[ecu.reply]]")
        return self
