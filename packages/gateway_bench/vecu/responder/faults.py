"""Faults of an ECU that answers: as testers meet them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from gateway_bench.vecu.contract import EcuFault
from gateway_bench.vecu.responder.params import Hex


class ResponderFault(EcuFault):
    """A fault of the answers to UDS and OBD requests."""

    kind: Literal["slow", "pending", "sequence", "reset", "mute", "echo", "refuse", "reading"]
    from_s: float = Field(0.0, ge=0, allow_inf_nan=False, description="[s]")
    to_s: float | None = Field(None, gt=0, allow_inf_nan=False, description="[s]; default: the end")
    probability: float = Field(1.0, gt=0, le=1, description="share of the requests that it concerns")
    by_ms: float = Field(
        1000.0, gt=0, le=600_000, allow_inf_nan=False,
        description="slow: how much later; pending: time between two 0x78; reset: how long it is off [ms]",
    )  # fmt: skip
    code: int = Field(0x22, ge=1, le=0xFF, description="refuse: negative response code")

    request: Hex | None = Field(None, description="reading: of which of the values")
    number: int | None = Field(None, ge=0, description="reading: instead of its course")

    @model_validator(mode="after")
    def _times(self) -> Self:
        if (self.kind == "reading") != (self.request is not None and self.number is not None):
            raise ValueError("reading wants request and number; no other kind has them")
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError("to_s: after from_s")
        return self

    @property
    def by_ns(self) -> int:
        """Its time [ns]."""
        return round(self.by_ms * 1e6)

    def active(self, t_ns: int) -> bool:
        """Return whether it is there at a time [ns]."""
        return self.from_s * 1e9 <= t_ns and (self.to_s is None or t_ns < self.to_s * 1e9)


class Drawn:
    """The faults of one ECU."""

    def __init__(self, faults: Sequence[ResponderFault], rng: np.random.Generator) -> None:
        self._faults, self._rng = faults, rng

    def of(self, t_ns: int, request: bytes) -> ResponderFault | None:
        """Return the fault of a request that comes at a time [ns]: the first that concerns it."""
        for fault in self._faults:
            if fault.request is not None and bytes.fromhex(fault.request) != request:
                continue
            if fault.active(t_ns) and (fault.probability == 1 or self._rng.random() < fault.probability):
                return fault
        return None


def other_echo(answer: bytes) -> bytes:
    """Return a positive answer to another request of the same service: the last byte of its echo is another one."""
    place = 2 if answer[0] == 0x62 and len(answer) > 2 else 1
    if len(answer) <= place:
        return bytes([answer[0] ^ 0x01]) + answer[1:]
    return answer[:place] + bytes([answer[place] ^ 0x01]) + answer[place + 1 :]
