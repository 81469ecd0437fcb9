"""Data identifiers: UDS 0x22 reads them, 0x2E writes them, and freeze frames consist of them."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import InputError

#: struct codes of the numeric types, high byte first.
CODES = {
    "u8": "B",
    "u16": "H",
    "u32": "I",
    "i8": "b",
    "i16": "h",
    "i32": "i",
    "f32": "f",
    "f64": "d",
}

#: First identifier given to signals of freeze frames that the configuration gives none.
FIRST_OWN = 0x4000

#: Identifiers that the server answers itself, and ranges that ISO 14229-1 (Annex C.1) reserves.
ACTIVE_SESSION = 0xF186


class DidParams(StrictModel):
    """One data identifier: a signal, a text, or bytes."""

    id: int = Field(ge=0x0100, le=0xFEFF, description="data identifier, e.g. 0xF190")
    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_]+$")] = Field(
        description="how freeze frames refer to it"
    )
    signal: str | None = Field(None, description='"Message.Signal", "bus.Message.Signal" or "monitor:value"')
    type: Literal["u8", "u16", "u32", "i8", "i16", "i32", "f32", "f64"] = Field(
        "f32", description="how a signal's value is coded, high byte first"
    )
    scale: float = Field(1.0, allow_inf_nan=False, description="signal's unit for one step")
    offset: float = Field(0.0, allow_inf_nan=False, description="value of a coded 0, signal's unit")
    text: str | None = Field(None, description="constant text (ASCII)")
    hex: str | None = Field(None, description="constant bytes, as hex digits")
    writable: bool = Field(False, description="a tester may write it (text or bytes, same length)")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if sum(source is not None for source in (self.signal, self.text, self.hex)) != 1:
            raise ValueError("give one of signal, text, hex")
        if self.signal is not None and self.writable:
            raise ValueError("a signal cannot be written")
        if self.scale == 0:
            raise ValueError("scale must not be 0")
        if self.id == ACTIVE_SESSION:
            raise ValueError("0xF186 is the active session, which the server answers itself")
        if self.text is not None and not (self.text.isascii() and self.text):
            raise ValueError("text must be ASCII, and not empty")
        if self.hex is not None:
            try:
                given = bytes.fromhex(self.hex)
            except ValueError as error:
                raise ValueError("hex: an even number of hex digits") from error
            if not given:
                raise ValueError("hex must not be empty")
        return self

    def encode(self, value: float | None) -> bytes:
        """Code a signal's value; an unknown one is all ones, one out of range the nearest end."""
        code = CODES[self.type]
        known = value is not None and math.isfinite(value)
        if self.type.startswith("f"):
            scaled = (value - self.offset) / self.scale if value is not None and known else math.nan
            try:
                return struct.pack(">" + code, scaled)
            except OverflowError:  # beyond float32
                return struct.pack(">" + code, math.copysign(math.inf, scaled))
        size = struct.calcsize(code)
        if value is None or not known:
            return b"\xff" * size
        low = -(1 << (8 * size - 1)) if self.type.startswith("i") else 0
        high = low + (1 << (8 * size)) - 1
        scaled = (value - self.offset) / self.scale
        return struct.pack(">" + code, round(min(max(scaled, low), high)))

    @property
    def constant(self) -> bytes:
        """Its bytes, if it is no signal."""
        return self.text.encode() if self.text is not None else bytes.fromhex(self.hex or "")


class Identifiers:
    """The table of data identifiers.

    Args:
        params: those of the configuration.
        frozen: further signals that freeze frames hold; each gets an identifier of its own, in order.
        read: signal name -> its value now.
        written: values that testers wrote, by identifier.
        write: keeps a value, durable on return.
    """

    def __init__(
        self,
        params: Sequence[DidParams],
        frozen: Iterable[str],
        read: Callable[[str], float],
        written: Mapping[int, bytes],
        write: Callable[[int, bytes], None],
    ) -> None:
        self._read = read
        self._written = written
        self._write = write
        self._others: Callable[[int], bytes | None] = lambda _: None
        self._served: dict[int, tuple[str, Callable[[], bytes]]] = {}
        self.table = {did.id: did for did in params}
        self._by_source = {did.signal: did for did in params if did.signal is not None}
        self._by_source |= {did.name: did for did in params}
        free = (number for number in range(FIRST_OWN, 0xF000) if number not in self.table)
        for number, signal in zip(free, sorted(set(frozen) - self._by_source.keys()), strict=False):
            name = re.sub(r"[^A-Za-z0-9_]", "_", signal)
            did = DidParams(id=number, name=name, signal=signal)
            self.table[number] = self._by_source[signal] = did

    def serve(self, number: int, name: str, read: Callable[[], bytes]) -> None:
        """Add an identifier that the gateway itself has something to say by."""
        self._served[number] = name, read

    def fall_back(self, read: Callable[[int], bytes | None]) -> None:
        """Have identifiers that are not in the table read elsewhere; None: not there either."""
        self._others = read

    def read(self, number: int) -> bytes | None:
        """Return the bytes of an identifier now, None if there is none."""
        if number in self._served:
            return self._served[number][1]()
        did = self.table.get(number)
        if did is None:
            return self._others(number)
        if did.signal is not None:
            return did.encode(self._read(did.signal))
        written = self._written.get(number)
        return written if written is not None and len(written) == len(did.constant) else did.constant

    def write(self, number: int, data: bytes) -> None:
        """Keep what a tester wrote; durable on return.

        Raises:
            StoreError: it could not be written; the value is what it was.
        """
        self._write(number, data)

    def freeze_frame(self, content: Mapping[str, float | None]) -> list[tuple[int, bytes]]:
        """Return a freeze frame as identifiers and their bytes.

        Signals that the configuration no longer has are left out.
        """
        found: dict[int, bytes] = {}
        for name, value in content.items():
            did = self._by_source.get(name)
            if did is not None:  # a signal and the name of its identifier are one
                found.setdefault(did.id, did.encode(value))
        return list(found.items())

    def describe(self) -> list[dict[str, Any]]:
        """Return the table for people and programs."""
        return [
            {
                "id": f"0x{number:04X}",
                "name": did.name,
                "signal": did.signal,
                "type": did.type if did.signal else "bytes",
                "length": len(self.read(number) or b""),
                "scale": did.scale if did.signal else None,
                "offset": did.offset if did.signal else None,
                "writable": did.writable,
            }
            for number, did in sorted(self.table.items())
        ] + [
            {
                "id": f"0x{number:04X}", "name": name, "signal": None, "type": "bytes", "length": None, "scale": None,
                "offset": None, "writable": False,
            }
            for number, (name, _) in self._served.items()
        ]  # fmt: skip


def check_unique(params: Sequence[DidParams]) -> list[InputError]:
    """Return an error for each identifier or name that is given twice."""
    wrong = []
    for k, did in enumerate(params):
        if did.id in [other.id for other in params[:k]]:
            wrong.append(InputError("this identifier is taken", key=f"did[{k}].id", value=f"0x{did.id:04X}"))
        if did.name in [other.name for other in params[:k]]:
            wrong.append(InputError("this name is taken", key=f"did[{k}].name", value=did.name))
    return wrong
