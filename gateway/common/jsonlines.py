"""JSON as this project writes it: no numbers that JSON lacks, one document a line."""

from __future__ import annotations

import json
import math
from typing import Any


def _strict(value: Any) -> Any:
    """Return a value in which numbers that JSON lacks (NaN, infinities) are null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    return value


def line(value: Any, *, indent: int | None = None) -> str:
    """Return a value as one line of JSON, without its end; as several for people, with an indent."""
    try:
        return json.dumps(value, allow_nan=False, indent=indent)
    except ValueError:  # rare, and a search for them takes longer than all else
        return json.dumps(_strict(value), indent=indent)
