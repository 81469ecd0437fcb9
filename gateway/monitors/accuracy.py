"""How exact a sensor is, as its data sheet says it: shares and sizes with units, in TOML."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, PlainValidator

from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.structure.units import differ

_PERCENT = re.compile(r"\s*([0-9.eE+-]+)\s*%\s*")
_SIZED = re.compile(r"\s*([0-9.eE+-]+)\s*(\S.*?)?\s*")


def _share(value: Any) -> Any:
    """Return "20 %" as 0.2; all else as it is."""
    found = _PERCENT.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        if isinstance(value, str):
            raise ValueError('write a share as "5 %", or as 0.05')
        return value
    return float(found[1]) / 100.0


#: A share of something, above 0 and below 1, or "20 %".
Share = Annotated[float, BeforeValidator(_share, json_schema_input_type=str | float), Field(gt=0, lt=1)]


class Sized(NamedTuple):
    """A size with its unit, empty if none is given."""

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}".strip()


def _sized(value: Any) -> Sized:
    if isinstance(value, Sized):
        return value
    found = _SIZED.fullmatch(value if isinstance(value, str) else f"{value}")
    try:
        size = float(found[1]) if found is not None else math.nan
    except ValueError:
        size = math.nan
    if isinstance(value, bool) or found is None or not 0.0 < size < math.inf:
        raise ValueError('write a size above 0 with its unit, as "0.1 V"')
    return Sized(size, found[2] or "")


#: A size above 0 in TOML, "0.1 V" or 0.1.
SizeText = Annotated[Sized, PlainValidator(_sized, json_schema_input_type=str | float), PlainSerializer(str)]


def in_unit(unit: str) -> Callable[[Sized], Sized]:
    """Return a validator that refuses a size in another unit; one without a unit is taken to be in this one."""

    def checked(size: Sized) -> Sized:
        if differ(size.unit, unit):
            raise ValueError(f'its unit is "{unit}"')
        return size

    return checked


class Accuracy(StrictModel):
    """By how much a sensor may be off, of its data sheet."""

    gain: Share | None = Field(None, description='of its reading, as "0.5 %"')
    bias: SizeText | None = Field(None, description='in the unit of the known variable, as "0.1 V"')


class LateAccuracy(Accuracy):
    """By how much it may also be late, or early."""

    lag: Annotated[SizeText, AfterValidator(in_unit("ms"))] | None = Field(
        None, description='by how much older, or newer, its reading may be than the others, as "5 ms"; followed'
    )
