"""TOML files into pydantic models, with every mistake named at once."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from gateway.errors import InputError, InputErrors

M = TypeVar("M", bound=BaseModel)


class StrictModel(BaseModel):
    """Base of what is read from TOML: unknown keys are errors, and nothing changes later."""

    model_config = ConfigDict(extra="forbid", frozen=True)


_PLACE = re.compile(r"\(at line (\d+), column \d+\)")


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        InputError: not readable, not UTF-8, or not TOML; names the line where there is one.
    """
    try:
        text = path.read_bytes().decode("utf-8")
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text (byte {error.start})", file=path) from error
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = _PLACE.search(str(error))
        line = int(found[1]) if found else text.count("\n") + 1
        raise InputError(_PLACE.sub("", str(error)).strip(), file=path, line=line) from error


def key_path(location: tuple[int | str, ...]) -> str:
    """Return pydantic's location as the dotted path of a TOML key: ``monitor[0].gain``."""
    path = ""
    for part in location:
        if isinstance(part, int):
            path += f"[{part}]"
        else:
            quoted = part if re.fullmatch(r"[A-Za-z0-9_-]+", part) else f'"{part}"'
            path += f".{quoted}" if path else quoted
    return path


def _place(location: tuple[int | str, ...], data: Any) -> tuple[int | str, ...]:
    """Return a location without the names of union members, which are no keys of the file."""
    place: list[int | str] = []
    for k, part in enumerate(location):
        last = k == len(location) - 1
        if isinstance(part, str) and isinstance(data, dict) and part not in data and not last:
            continue
        place.append(part)
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            data = None
    return tuple(place)


def input_errors(
    error: ValidationError, file: Path | None, prefix: str = "", *, data: Any = None
) -> InputErrors:
    """Turn pydantic's error into ours, one entry for each key.

    Args:
        error: pydantic's.
        file: where the data stand.
        prefix: key path of the data in it.
        data: what was validated.
    """
    found = []
    details = error.errors(include_url=False)
    places = [detail["loc"] for detail in details]
    for detail in details:
        here = detail["loc"]
        inner = any(place[: len(here)] == here and place != here for place in places)
        if detail["type"] == "too_short" and inner:
            continue  # its items are there, but wrong
        key = key_path(_place(tuple(here), data))
        if prefix:
            key = f"{prefix}.{key}" if key else prefix
        message = detail["msg"].removeprefix("Value error, ")
        value = None if detail["type"] in {"missing", "extra_forbidden"} else detail["input"]
        if detail["type"] == "extra_forbidden":
            message = "unknown key"
        elif detail["type"] == "missing":
            message = "this key is missing"
        found.append(InputError(message, file=file, key=key, value=value))
    return InputErrors(found)


def validate(data: dict[str, Any], model: type[M], file: Path | None, prefix: str = "") -> M:
    """Check data against a model.

    Raises:
        InputErrors: every key that is wrong, with its value and what would be right.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise input_errors(error, file, prefix, data=data) from error


def load(path: Path, model: type[M]) -> M:
    """Read a TOML file into a model (see :func:`read_toml` and :func:`validate`)."""
    return validate(read_toml(path), model, path)
