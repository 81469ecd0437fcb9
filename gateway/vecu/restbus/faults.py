"""What can be wrong with a signal, with a message's protection, and with its frames."""

from __future__ import annotations

from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gateway.bus.frames import Frames
from gateway.errors import InputError
from gateway.signals.bits import mask_of
from gateway.signals.protection.protection import protect
from gateway.vecu import sensor_faults
from gateway.vecu.contract import EcuFault, Truth
from gateway.vecu.scenario import WireFault
from gateway.vecu.wire_faults import apply_wire_faults

SignalKind = Literal["stuck", "offset", "gain", "drift", "noise", "value", "out_of_range"]
ProtectionKind = Literal["counter", "checksum"]
#: Of frames, as a fault of the wire; what the wire calls it.
WireKind = Literal["lost", "late", "doubled", "short"]
_WIRE: dict[str, Literal["lost", "late", "duplicated", "short"]] = {
    "lost": "lost", "late": "late", "doubled": "duplicated", "short": "short",
}  # fmt: skip
#: Of these, those that want a size.
SIZED = ("offset", "gain", "drift", "noise", "value")


class RestbusFault(EcuFault):
    """A fault of one signal, or of one message."""

    kind: Literal[
        "stuck", "offset", "gain", "drift", "noise", "value", "out_of_range",
        "counter", "checksum", "lost", "late", "doubled", "short",
    ]  # fmt: skip
    ecu: str = Field("restbus", description="name of the ECU")
    signal: str | None = Field(None, description='"Message.Signal", for a fault of a signal')
    message: str | None = Field(None, description="name of a message, for a fault of its frames")
    from_s: float = Field(ge=0, description="[s]")
    to_s: float | None = Field(None, gt=0, description="[s]; default: the end")
    size: float | None = Field(
        None,
        allow_inf_nan=False,
        description="offset, value, standard deviation of the noise, drift per second: signal's unit; gain: a factor; "
        "out_of_range: the value, default what its bits carry beyond its range; counter: its step, default 0",
    )
    delay_ms: float = Field(30.0, gt=0, allow_inf_nan=False, description="of late frames [ms]")
    probability: float = Field(1.0, gt=0, le=1, description="that a frame is lost, late, doubled or short")

    @property
    def of_signal(self) -> bool:
        """Whether it is a fault of a signal."""
        return self.kind in get_args(SignalKind)

    @property
    def target(self) -> str:
        """The message that it concerns."""
        return str(self.message) if self.signal is None else self.signal.rpartition(".")[0]

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError("to_s must lie after from_s")
        wanted, other = ("signal", "message") if self.of_signal else ("message", "signal")
        if getattr(self, wanted) is None or getattr(self, other) is not None:
            raise ValueError(f"{self.kind} is a fault of a {wanted}: give {wanted}, and no {other}")
        if self.kind in SIZED and self.size is None:
            raise ValueError(f"{self.kind} wants a size")
        return self


def window(fault: RestbusFault, times: NDArray[np.float64]) -> tuple[int, int]:
    """Return the first frame that a fault concerns, and the one after the last."""
    end = len(times) if fault.to_s is None else int(np.searchsorted(times, fault.to_s))
    return int(np.searchsorted(times, fault.from_s)), end


def faulty(
    fault: RestbusFault,
    values: NDArray[np.float64],
    times: NDArray[np.float64],
    beyond: float | None,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Return a signal's values with a fault in them.

    Args:
        fault: of a signal.
        values: shape (n,).
        times: of the frames, shape (n,) [s].
        beyond: a value out of its range that it can carry, None: there is none.
        rng: source of all randomness.

    Raises:
        InputError: a signal without a value out of its range.
    """
    begin, end = window(fault, times)
    n, size = len(values), fault.size or 0.0
    if begin >= end:
        return values
    if fault.kind == "stuck":
        return sensor_faults.stuck(values, begin, end)
    if fault.kind == "offset":
        return values + sensor_faults.offset(n, begin, end, size)
    if fault.kind == "gain":
        return np.where((np.arange(n) >= begin) & (np.arange(n) < end), values * size, values)
    if fault.kind == "drift":
        step = (times[-1] - times[0]) / max(n - 1, 1)
        return values + sensor_faults.drift(n, begin, end, size * step)
    if fault.kind == "noise":
        return values + sensor_faults.offset(n, begin, end, 1.0) * rng.normal(0.0, size, n)
    level = fault.size if fault.size is not None else beyond
    if level is None:
        text = "its bits carry no value out of the range that the database gives; give a size, or another kind"
        raise InputError(text, key="fault.signal", value=fault.signal)
    return sensor_faults.at_rail(values, begin, end, level)


def unprotect(
    fault: RestbusFault, words: NDArray[np.uint64], times: NDArray[np.float64], length: int, row: Any, tables: Any
) -> None:
    """Make the counter or the checksum of protected payloads wrong.

    The checksum over a wrong counter is right: its sender made both.

    Args:
        fault: ``counter`` or ``checksum``.
        words: payloads, shape (n, 8); changed.
        times: of the frames [s].
        length: of the payloads [byte].
        row: record of ProtectionConst.
        tables: of the CRCs.

    Raises:
        InputError: a message without what is to be wrong.
    """
    begin, end = window(fault, times)
    if not (row.has_counter if fault.kind == "counter" else row.has_checksum):
        raise InputError(f"its protection has no {fault.kind}", key="fault.message", value=fault.message)
    if fault.kind == "checksum":
        words[begin:end] ^= np.frombuffer(mask_of(row.field).to_bytes(64, "little"), "<u8")
        return
    step = round(fault.size or 0.0)
    for k in range(begin, end):
        protect(words[k], length, max(begin - 1, 0) + step * (k - begin + 1), row, tables)


def on_wire(fault: RestbusFault, frames: Frames, rng: np.random.Generator) -> tuple[Frames, list[Truth]]:
    """Return a message's frames with a fault of its frames, and what was done."""
    asked = WireFault(
        kind=_WIRE[fault.kind], from_s=fault.from_s, to_s=fault.to_s, probability=fault.probability,
        delay_ms=fault.delay_ms,
    )  # fmt: skip
    frames, truth = apply_wire_faults(frames, [asked], rng)
    return frames, [Truth(fact.t_ns, fault.kind, fact.count) for fact in truth]
