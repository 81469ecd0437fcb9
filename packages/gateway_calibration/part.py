"""Findings of one log, apart from the others: many workers find them, and one place puts them together.

A part is written exactly (NumPy's ``.npz``: numbers keep all their bits), so that parts put together from files are
those of one process.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.common.archives import members_of
from gateway_fdi.errors import InputError

_FACTS, _ARRAY = "facts", "of "


@dataclass(frozen=True)
class Part:
    """Findings of a log.

    Attributes:
        seconds: of it that count.
        failed: DTCs that it set.
        arrays: by monitor, of the shape that each kind of calibration says.
        facts: everything that is no array, as JSON.
    """

    seconds: float
    failed: tuple[str, ...] = ()
    arrays: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)


#: Log -> what it says; the parts of one calibration in the order of its logs.
Parts = Mapping[Path, Part]
#: Finder of a part.
Find = Callable[[Path], Part]


def failed_in(parts: Parts) -> tuple[str, ...]:
    """Return the DTCs that logs set."""
    return tuple(sorted({dtc for part in parts.values() for dtc in part.failed}))


def save(path: Path, part: Part) -> None:
    """Write a part: the file is there whole or not at all."""
    facts = json.dumps({"seconds": part.seconds, "failed": part.failed, "facts": part.facts})
    arrays: dict[str, Any] = {_ARRAY + name: value for name, value in part.arrays.items()}
    arrays[_FACTS] = np.frombuffer(facts.encode(), np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with unfinished.open("wb") as file:
            np.savez_compressed(file, **arrays)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def load(path: Path) -> Part | None:
    """Read a part, None if there is none that can be read: then it is to be found again."""
    try:
        held = {
            name.removesuffix(".npy"): np.load(BytesIO(data), allow_pickle=False)  # noqa: TID251 - of bytes
            for name, data in members_of(path, ".npy")
        }
        facts = json.loads(held[_FACTS].tobytes())
        arrays = {name[len(_ARRAY) :]: array for name, array in held.items() if name.startswith(_ARRAY)}
        return Part(float(facts["seconds"]), tuple(facts["failed"]), arrays, facts["facts"])
    except (InputError, OSError, ValueError, KeyError, TypeError, EOFError):
        return None
