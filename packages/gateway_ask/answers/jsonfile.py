"""Parts of a JSON file, each with its place, so that what is wrong is named by file, key and value."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gateway.signals.bounds import LONGEST
from gateway_fdi.errors import InputError


class Place(NamedTuple):
    """Names a part of a file in errors."""

    file: Path
    key: str

    def at(self, key: str) -> Place:
        """Return the place of a key below it."""
        return Place(self.file, f"{self.key}.{key}" if self.key else key)

    def wrong(self, message: str, value: object = None) -> InputError:
        """Return an error that names it."""
        return InputError(message, file=self.file, key=self.key or None, value=value)


def object_at(value: Any, place: Place) -> Mapping[str, Any]:
    """Return an object, as a mapping.

    Raises:
        InputError: it is none; names key and value.
    """
    if not isinstance(value, dict):
        raise place.wrong("must be an object", value)
    return value


def list_at(value: Any, place: Place) -> list[Any]:
    """Return a list.

    Raises:
        InputError: it is none; names key and value.
    """
    if not isinstance(value, list):
        raise place.wrong("must be a list", value)
    return value


def hex_at(table: Mapping[str, Any], key: str, place: Place, most: int) -> int | None:
    """Return the number of a key's hexadecimal digits; None: the key is not there.

    Raises:
        InputError: it is none; names key and value.
    """
    value = table.get(key)
    if value is None:
        return None
    try:
        number = int(value, 16) if isinstance(value, str) else -1
    except ValueError:
        number = -1
    if not 0 <= number <= most:
        raise place.at(key).wrong(f"must be hexadecimal digits, at most {most:X}", value)
    return number


def number_at(table: Mapping[str, Any], key: str, place: Place) -> float | None:
    """Return a key's number; None: the key is not there.

    Raises:
        InputError: it is none; names key and value.
    """
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise place.at(key).wrong("must be a finite number", value)
    return value


def count_at(table: Mapping[str, Any], key: str, place: Place, default: int | None, least: int) -> int:
    """Return a key's whole number, within what a layout can have.

    Raises:
        InputError: it is none; names key and value.
    """
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= 8 * LONGEST:
        raise place.at(key).wrong(f"must be a whole number from {least} on, at most {8 * LONGEST}", value)
    return value


def document_of(path: Path) -> dict[str, Any]:
    """Return the contents of a file.

    Raises:
        InputError: it cannot be read, or is no object of JSON.
    """
    try:
        document = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except json.JSONDecodeError as error:
        raise InputError(f"no good JSON: {error.msg}", file=path, line=error.lineno) from error
    except (UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"no good JSON: {error}", file=path) from error
    return dict(object_at(document, Place(path, "")))
