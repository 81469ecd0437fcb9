"""TOML files into pydantic models, with every mistake named at once."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from gateway_fdi.errors import InputError, InputErrors, nearest

M = TypeVar("M", bound=BaseModel)

#: As many keys are listed when none is close to an unknown one.
MOST_KEYS = 16


class StrictModel(BaseModel):
    """Base of what is read from TOML: unknown keys are errors, numbers are finite, and nothing changes later.

    TOML has nan and inf. A threshold that is one makes comparisons that are always false: a monitor that sees nothing.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


#: Tables and arrays within each other, at most: ours have six.
DEEPEST = 64
#: A key with more parts than that, which would take the parser time with the square of them; no backtracking.
_PART = r"""(?>[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY = re.compile(rf"^[ \t]*+\[{{0,2}}+[ \t]*+({_PART})(?:\.[ \t]*+{_PART}){{{DEEPEST}}}", re.MULTILINE)
_PLACE = re.compile(r"\(at line (\d+), column \d+\)")


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        InputError: not readable, not UTF-8, or not TOML (see :func:`parse_toml`).
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")  # Notepad begins a file with a mark
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text (byte {error.start})", file=path) from error
    return parse_toml(text, path)


def parse_toml(text: str, path: Path | None = None) -> dict[str, Any]:
    """Read TOML.

    Raises:
        InputError: it is not, or nested deeper than :data:`DEEPEST`; names the line where there is one.
    """
    if long := _LONG_KEY.search(text):
        raise _too_deep(path, long[1].strip(), text.count("\n", 0, long.start()) + 1)
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise _too_deep(path, *_deep_place(text)) from None
    except tomllib.TOMLDecodeError as error:
        found = _PLACE.search(str(error))
        line = int(found[1]) if found else text.rstrip().count("\n") + 1
        key, message = _cured(_PLACE.sub("", str(error)).strip(), (text.splitlines() or [""])[line - 1])
        raise InputError(message, file=path, line=line, key=key) from error
    except ValueError as error:  # a number of thousands of digits
        digits = re.search(r"\d[\d_]{4000}", text)
        place = text.count("\n", 0, digits.start()) + 1 if digits else None
        raise InputError(f"not a good value: {error}", file=path, line=place) from error
    for key, value in data.items():
        if _is_too_deep(value):
            raise _too_deep(path, key, None)
    return data


#: Beginning of an error of tomllib -> words that help.
_CURES = (
    ("Invalid value", "no value of TOML: a text is in quotes, a number has a point, true and false have no capital"),
    ("Expected '=' after", "a line is KEY = VALUE, or a table's [NAME]"),
    ("Invalid statement", "no line of TOML: it is KEY = VALUE, [NAME], or a comment after #"),
    ("Cannot overwrite", "this key or table is here twice; tables of a list have two brackets each, [[NAME]]"),
    ("Cannot declare", "this table is here twice; tables of a list have two brackets each, [[NAME]]"),
    ("Cannot mutate", "this table is complete already: write the key where it began"),
    ("Cannot redefine", "this key is a table or a value already"),
    ("Duplicate inline", "this key is twice in a table of one line"),
    ("Unclosed", "a bracket is missing at the end"),
    ("Expected newline", "one value a line: what stands behind it belongs in quotes, or after #"),
    ("Expected ']'", "a bracket is missing at the end of the table's name"),
    ("Unterminated", "a quote is missing at the end of the text"),
    ("Expected \"'\"", "a quote is missing at the end of the text"),
    ("Illegal character", "a quote is missing at the end of the text, or a character that text cannot have"),
    ("Unescaped", "a backslash in a text: write it twice, or the text in single quotes"),
    ("Invalid initial character", "no name of a key: letters, digits, _ and -, or quotes"),
    ("Found invalid character", "no name of a key: letters, digits, _ and -, or quotes"),
    ("Invalid date", "no date: 2026-11-29, or 2026-11-29T12:00:00Z"),
)  # fmt: skip
_KEY_OF_LINE = re.compile(r"""\s*([\w."'-]+)\s*(?:=|$)""")


def _cured(said: str, line: str) -> tuple[str | None, str]:
    """Return the key that a line of TOML is about, and what is to be written, where tomllib is known to say this."""
    found = _KEY_OF_LINE.match(line)
    cure = next((cure for begin, cure in _CURES if said.startswith(begin)), "")
    shown = " ".join(line.split())[:60]
    return found[1] if found else None, f"{shown!r}: {cure}" if cure else f"{shown!r}: {said}"


def _too_deep(path: Path | None, key: str | None, line: int | None) -> InputError:
    return InputError(f"nested deeper than {DEEPEST} tables and arrays", file=path, line=line, key=key)


def _deep_place(text: str) -> tuple[str | None, int | None]:
    """Return the key and the line where a text is nested too deeply; brackets in strings are counted, too."""
    depth, key = 0, None
    for number, line in enumerate(text.splitlines(), 1):
        if found := re.match(r"\s*([\w.-]+)\s*=", line):
            key = found[1] if depth <= 0 else key
        for character in line:
            depth += (character in "[{") - (character in "]}")
            if depth > DEEPEST:
                return key, number
    return key, None


def _is_too_deep(value: Any) -> bool:
    """Return whether a value of a file is nested too deeply: later readers may be recursive."""
    level = [value]
    for _ in range(DEEPEST):
        level = [
            inner
            for outer in level
            if isinstance(outer, dict | list)
            for inner in (outer.values() if isinstance(outer, dict) else outer)
        ]
        if not level:
            return False
    return True


def texts_in(value: Any) -> Iterator[str]:
    """Yield all texts that are values in a value of TOML: in tables and lists, too."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list | tuple):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from texts_in(inner)


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


def _place(location: tuple[int | str, ...], data: Any, *, missing: bool) -> tuple[int | str, ...]:
    """Return a location without the names of union members, which are no keys of the file.

    Args:
        location: pydantic's.
        data: that were validated.
        missing: its last part is a key that is not there.
    """
    place: list[int | str] = []
    for k, part in enumerate(location):
        last = missing and k == len(location) - 1
        known = k > 0 and data is not None  # else it may come from the environment
        if known and isinstance(part, str) and not last and not (isinstance(data, dict) and part in data):
            continue
        place.append(part)
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            data = None
    return tuple(place)


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Return the models that an annotation names, in tuples, unions, ... too."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _models_at(model: type[BaseModel] | None, place: tuple[int | str, ...]) -> list[type[BaseModel]]:
    """Return the models that stand at a place of a model."""
    found = [] if model is None else [model]
    for part in place:
        fields = [of.model_fields[part] for of in found if part in of.model_fields]
        if fields:  # else a number, the name of a union's member, or of an entry of a dictionary
            found = [inner for field in fields for inner in _models(field.annotation)]
    return found


def _toml_name(key: str) -> str:
    return re.sub(r"\[\d+\]", "", key)


def _unknown(name: str, models: list[type[BaseModel]]) -> str:
    known = sorted({field for model in models for field in model.model_fields})
    close = nearest(name, known)
    if close or not 0 < len(known) <= MOST_KEYS:
        return f"unknown key{close}"
    return f"unknown key; the keys here are {', '.join(known)}"


def _missing(key: str, name: str, models: list[type[BaseModel]]) -> str:
    for model in models:
        field = model.model_fields.get(name)
        if field is None:
            continue
        text = f": {field.description}" if field.description else ""
        tables = get_origin(field.annotation) is tuple and _models(field.annotation)
        return f"this key is missing{text}" + (f"; write a table [[{_toml_name(key)}]] for each" if tables else "")
    return "this key is missing"


def _expected(detail: Any) -> list[str]:
    context = detail.get("ctx", {})
    return re.findall(r"'([^']*)'", str(context.get("expected_tags") or context.get("expected")))


def _explained(
    detail: Any, place: tuple[int | str, ...], key: str, model: type[BaseModel] | None
) -> tuple[str, str, object]:
    """Return one of pydantic's errors as (key, message, value)."""
    kind, value = detail["type"], detail["input"]
    message = detail["msg"].removeprefix("Value error, ")
    inside = _models_at(model, place[:-1])
    name = str(place[-1]) if place else ""
    if kind == "extra_forbidden":
        return key, _unknown(name, inside), None
    if kind == "missing":
        return key, _missing(key, name, inside), None
    if kind == "tuple_type":
        if isinstance(value, dict):
            toml = _toml_name(key)
            return key, f"a list of tables: write [[{toml}]], with two brackets", None
        return key, "a list: write [...]", value
    if kind in ("model_type", "dict_type") and isinstance(value, list):
        return key, f"one table: write [{_toml_name(key)}], with one bracket", None
    if kind == "model_type":
        here = sorted({field for of in _models_at(model, place) for field in of.model_fields})
        keys = f" with keys of {', '.join(here)}" if 0 < len(here) <= MOST_KEYS else ""
        return key, f"a table: write {{ ... }}{keys}", value
    if kind == "union_tag_not_found":
        tag = str(detail["ctx"]["discriminator"]).strip("'")
        return f"{key}.{tag}", "this key is missing: it tells which kind this is", None
    if kind in ("union_tag_invalid", "ecu_type") and isinstance(value, dict):
        tag = str(detail.get("ctx", {}).get("discriminator", "type")).strip("'")
        known = _expected(detail) or re.findall(r"\w+", message.partition(" are ")[2])
        given = str(value.get(tag))
        text = f"there are {', '.join(known)}{nearest(given, known)}"
        return f"{key}.{tag}", text, value.get(tag)
    if kind == "literal_error" and isinstance(value, str):
        known = _expected(detail)
        return key, f"there are {', '.join(known)}{nearest(value, known)}", value
    return key, _in_words(kind, detail.get("ctx", {})) or message, value


#: Kind of pydantic's error -> words with its context.
_WORDS = {
    "int_parsing": "a whole number: write it without a unit and without quotes, as 500000",
    "int_type": "a whole number: write it without quotes, as 500000",
    "int_from_float": "a whole number",
    "float_parsing": "a number: write it without a unit and without quotes, as 0.5",
    "float_type": "a number: write it without quotes, as 0.5",
    "finite_number": "a finite number",
    "bool_parsing": "true or false",
    "bool_type": "true or false",
    "string_type": "a text: write it in quotes",
    "path_type": "the name of a file: write it in quotes",
    "greater_than": "a number above {gt}",
    "greater_than_equal": "a number of {ge} at least",
    "less_than": "a number below {lt}",
    "less_than_equal": "a number of {le} at most",
    "string_too_short": "a text of {min_length} characters at least",
    "string_too_long": "a text of {max_length} characters at most",
    "string_pattern_mismatch": "a text of the form {pattern}",
    "too_short": "a list of {min_length} at least; there are {actual_length}",
    "too_long": "a list of {max_length} at most; there are {actual_length}",
    "multiple_of": "a multiple of {multiple_of}",
}
#: From there on a whole limit is told in hex, too.
_HEX_FROM = 256


def _in_words(kind: str, context: dict[str, Any]) -> str:
    """Return an error of pydantic in words for people, "": it has none here."""
    told = {
        name: f"{limit:g}" if isinstance(limit, float) else f"{limit} (0x{limit:X})"
        if isinstance(limit, int) and limit >= _HEX_FROM else str(limit)
        for name, limit in context.items()
    }  # fmt: skip
    return _WORDS.get(kind, "").format_map(told)


#: Errors that say no more than that something is of another kind.
_KINDS = re.compile(r"(int|float|string|bool|model|dict|tuple|literal)_(type|parsing|error)")


def _telling(
    details: list[Any], places: list[tuple[int | str, ...]], model: type[BaseModel] | None
) -> Iterator[tuple[Any, tuple[int | str, ...]]]:
    """Yield those of pydantic's errors that tell something: of a mistake that makes several, one."""
    unknown = [place for detail, place in zip(details, places, strict=True) if detail["type"] == "extra_forbidden"]
    told: set[tuple[int | str, ...]] = set()
    for detail, place in zip(details, places, strict=True):
        kind = detail["type"]
        inner = any(other[: len(place)] == place and other != place for other in places)
        if kind == "too_short" and inner:
            continue  # its items are there, but wrong
        if kind == "missing" and any(
            other[:-1] == place[:-1] and str(place[-1]) in _unknown(str(other[-1]), _models_at(model, place[:-1]))
            for other in unknown
        ):
            continue  # it is there, misspelt
        same = [d for d, other in zip(details, places, strict=True) if other == place]
        if _KINDS.fullmatch(kind) and len(same) + inner > 1:  # one member of a union does not take it
            if inner or not all(_KINDS.fullmatch(other["type"]) for other in same) or place in told:
                continue
            told.add(place)
        yield detail, place


def input_errors(
    error: ValidationError,
    file: Path | None,
    prefix: str = "",
    *,
    data: Any = None,
    model: type[BaseModel] | None = None,
) -> InputErrors:
    """Turn pydantic's error into a gateway error, one entry for each key.

    Args:
        error: pydantic's.
        file: where the data stand.
        prefix: key path of the data in it.
        data: that were validated.
        model: that they were validated against, for the names that there are.
    """
    found = []
    details = error.errors(include_url=False)
    places = [_place(tuple(detail["loc"]), data, missing=detail["type"] == "missing") for detail in details]
    for detail, place in _telling(details, places, model):
        own = key_path(place)
        key = f"{prefix}.{own}" if prefix and own else own or prefix
        key, message, value = _explained(detail, place, key, model)
        # An error of the data as a whole has no key of its own; its value would be everything.
        found.append(InputError(message, file=file, key=key, value=value if place else None))
    return InputErrors(found)


def validate(data: dict[str, Any], model: type[M], file: Path | None, prefix: str = "") -> M:
    """Check data against a model.

    Raises:
        InputErrors: every key that is wrong, with its value and the right form.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise input_errors(error, file, prefix, data=data, model=model) from error


def load(path: Path, model: type[M]) -> M:
    """Read a TOML file into a model (see :func:`read_toml` and :func:`validate`)."""
    return validate(read_toml(path), model, path)
