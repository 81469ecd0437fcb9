"""Parts of the gateway that other packages bring: by entry points, or by ``"package.module:NAME"``.

The gateway's own parts come through the same door. To list types imports nothing; to ask for one imports it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from pathlib import Path
from typing import Generic, TypeVar

from gateway.errors import InputError

T = TypeVar("T")

#: Our own distribution, whose types no other package can take.
OURS = "ecu-gateway"


def importable(folder: Path) -> None:
    """Let modules that lie in a folder be imported; installed ones come first."""
    place = str(folder.resolve())
    if place not in sys.path:
        sys.path.append(place)


@cache
def _own(group: str) -> dict[str, EntryPoint]:
    try:
        found = distribution(OURS).entry_points.select(group=group)
    except PackageNotFoundError:
        return {}
    return {entry.name: entry for entry in found}


@cache
def _all(group: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Return the entry points of all packages by name; to look for them takes a while."""
    found: dict[str, dict[str, EntryPoint]] = {}
    for entry in entry_points(group=group):
        found.setdefault(entry.name, {})[entry.value] = entry
    by_name = {name: tuple(entries.values()) for name, entries in found.items()}
    return by_name | {name: (entry,) for name, entry in _own(group).items()}


def foreign(group: str) -> list[str]:
    """Return the types of a group that other packages bring."""
    return sorted(_all(group).keys() - _own(group).keys())


def _load(place: str) -> object:
    """Import ``package.module:NAME``.

    Raises:
        InputError: it is not there, or cannot be imported.
    """
    module, _, name = place.partition(":")
    try:
        found: object = import_module(module)
    except Exception as error:  # whatever a plug-in does while it is imported, it is one line
        told = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise InputError(f"{module} cannot be imported: {told}", value=place) from error
    for part in name.split("."):
        if not hasattr(found, part):
            raise InputError(f"{module} has no {name}", value=place)
        found = getattr(found, part)
    return found


class Registry(Mapping[str, T], Generic[T]):
    """What can be named in a configuration, by type.

    Args:
        group: of entry points, type -> ``package.module:NAME``.
        accept: what was imported, its name -> the same, checked.
    """

    def __init__(self, group: str, accept: Callable[[object, str], T]) -> None:
        self.group, self._accept = group, accept
        self._known: dict[str, T] = {}

    def __getitem__(self, type_: str) -> T:
        """Return what a type stands for.

        Raises:
            KeyError: no package has it.
            InputError: it cannot be imported, is not what it should be, or two packages have it.
        """
        if type_ not in self._known:
            place = type_ if ":" in type_ else self._place(type_)
            self._known[type_] = self._accept(_load(place), place)
        return self._known[type_]

    def _place(self, type_: str) -> str:
        own = _own(self.group).get(type_)
        entries = (own,) if own is not None else _all(self.group)[type_]
        if len(entries) > 1:
            places = ", ".join(entry.value for entry in entries)
            raise InputError(f"several installed packages have this type: {places}", value=type_)
        return entries[0].value

    def __contains__(self, type_: object) -> bool:
        if not isinstance(type_, str):
            return False
        return ":" in type_ or type_ in _own(self.group) or type_ in _all(self.group)

    def __iter__(self) -> Iterator[str]:
        return iter(_all(self.group))

    def __len__(self) -> int:
        return len(_all(self.group))

    def described(self, types: Iterable[str] | None = None) -> dict[str, T | InputError]:
        """Return types, or all of all installed packages: what they stand for, or what is wrong with it."""
        found: dict[str, T | InputError] = {}
        for type_ in self if types is None else types:
            try:
                found[type_] = self[type_]
            except InputError as error:
                found[type_] = error
        return found
