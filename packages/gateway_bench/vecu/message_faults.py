"""Faults that every virtual ECU can have: of a signal that it sends, of a message, of itself."""

from __future__ import annotations

from typing import Literal, Protocol, Self, get_args

import numpy as np
from pydantic import Field, model_validator

from gateway_bench.vecu.contract import WHEN, EcuFault

SignalKind = Literal["stuck", "offset", "gain", "drift", "noise", "value", "out_of_range", "sna"]
EcuKind = Literal["bus_off"]
#: Of these, those that want a size.
SIZED = ("offset", "gain", "drift", "noise", "value")


class Timed(Protocol):
    """A fault by time, by a condition, or by both."""

    @property
    def from_s(self) -> float | None:
        """Its begin [s]."""

    @property
    def to_s(self) -> float | None:
        """Its end [s]."""

    @property
    def when(self) -> str | None:
        """Its condition."""


def begins(fault: Timed) -> None:
    """Refuse a fault without a begin, or one that ends before it begins.

    Raises:
        ValueError: it is one.
    """
    if fault.from_s is None and fault.when is None:
        raise ValueError("when does it begin? Give from_s, or a condition when")
    if fault.to_s is not None and fault.to_s <= (fault.from_s or 0.0):
        raise ValueError("to_s must lie after from_s")


class MessageFault(EcuFault):
    """A fault of one signal, of one message, or of the whole ECU; by time, by a condition, or by both."""

    kind: Literal[
        "stuck", "offset", "gain", "drift", "noise", "value", "out_of_range", "sna",
        "counter", "checksum", "lost", "late", "doubled", "short", "babbling", "bus_off",
    ]  # fmt: skip
    signal: str | None = Field(None, description='"Message.Signal", for a fault of a signal')
    message: str | None = Field(None, description="name of a message, for a fault of its frames")
    from_s: float | None = Field(None, ge=0, description="[s]; may be left out where there is a condition")
    to_s: float | None = Field(None, gt=0, description="[s]; default: the end")
    when: str | None = Field(None, min_length=1, description=WHEN)
    size: float | None = Field(
        None,
        allow_inf_nan=False,
        description="offset, value, standard deviation of the noise, drift per second: signal's unit; gain: a factor; "
        "out_of_range, sna: the value, default what the database says, or the bits can carry; "
        "counter: its step, default 0",
    )
    delay_ms: float = Field(30.0, gt=0, allow_inf_nan=False, description="of late frames [ms]")
    period_ms: float = Field(0.25, gt=0, le=1000, description="of a babbling ECU's frames [ms]")
    probability: float = Field(1.0, gt=0, le=1, description="that a frame is lost, late, doubled or short")

    @property
    def of_signal(self) -> bool:
        """Whether it is a fault of a signal."""
        return self.kind in get_args(SignalKind)

    @property
    def target(self) -> str | None:
        """The message that it concerns; None: all that the ECU sends."""
        return self.message if self.signal is None else self.signal.rpartition(".")[0]

    @model_validator(mode="after")
    def _whole(self) -> Self:
        begins(self)
        if self.kind in get_args(EcuKind):
            if self.signal is not None or self.message is not None:
                raise ValueError(f"{self.kind} is a fault of the ECU: give no signal, and no message")
            return self
        wanted, other = ("signal", "message") if self.of_signal else ("message", "signal")
        if getattr(self, wanted) is None or getattr(self, other) is not None:
            raise ValueError(f"{self.kind} is a fault of a {wanted}: give {wanted}, and no {other}")
        if self.kind in SIZED and self.size is None:
            raise ValueError(f"{self.kind} wants a size")
        return self


#: Kinds of message faults.
KINDS: tuple[str, ...] = get_args(MessageFault.model_fields["kind"].annotation)


class Effect:
    """Effect of a fault on a value, sample after sample.

    Args:
        kind: stuck, offset, gain, drift, noise; of any other the value is the size.
        size: in the signal's unit, a factor, per second.
        rng: source of all randomness.
    """

    def __init__(self, kind: str, size: float, rng: np.random.Generator) -> None:
        self._kind, self._size, self._rng = kind, size, rng
        self._since_ns: int | None = None
        self._held = 0.0

    def __call__(self, value: float, t_ns: int, *, active: bool) -> float:
        """Return a sample with the fault in it, as it is where the fault is not active."""
        if not active:
            self._since_ns = None
            return value
        if self._since_ns is None:
            self._since_ns, self._held = t_ns, value
        if self._kind == "stuck":
            return self._held
        if self._kind == "offset":
            return value + self._size
        if self._kind == "gain":
            return value * self._size
        if self._kind == "drift":
            return value + self._size * (t_ns - self._since_ns) * 1e-9
        if self._kind == "noise":
            return value + float(self._rng.normal(0.0, self._size))
        return self._size
