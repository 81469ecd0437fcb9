"""Structural models as a user writes them, in TOML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping


def equation(name: str, relation: str, unique: Iterable[str]) -> list[str]:
    """Return the lines of an equation that can be solved for some of its variables."""
    variables = ", ".join(f'"{variable}"' for variable in unique)
    return [f"[equation.{name}]", f'relation = "{relation}"', f"unique = [{variables}]"]


def _told(names: Mapping[str, str], key: str) -> Iterable[str]:
    return (f'{name} = {{ {key} = "{text}" }}' if text else f"{name} = {{}}" for name, text in names.items())


def written(
    *,
    unknown: Mapping[str, str],
    known: Iterable[str],
    faults: Mapping[str, str],
    parameters: Mapping[str, float],
    **equations: tuple[str, str],
) -> str:
    """Return a model.

    Args:
        unknown: variable -> its unit, empty: it has none.
        known: variables.
        faults: fault -> its text.
        parameters: parameter -> its value.
        equations: equation -> its relation, and the variables that it can be solved for, with spaces between.
    """
    lines = ["[unknown]", *_told(unknown, "unit"), "[known]", *_told(dict.fromkeys(known, ""), "")]
    lines += ["[fault]", *_told(faults, "text")]
    lines += ["[parameter]", *(f"{name} = {{ value = {value} }}" for name, value in parameters.items())]
    for name, (relation, unique) in equations.items():
        lines += equation(name, relation, unique.split())
    return "\n".join(lines) + "\n"
