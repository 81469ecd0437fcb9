"""Parts of the gateway that other packages bring.

They come by a :class:`~gateway.plugin.Plugin`, by entry points of a group, or by ``"package.module:NAME"``.
The gateway's own parts come through the same door. To list types imports nothing; to ask for one imports it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution, entry_points
from importlib.util import find_spec
from typing import Any, Generic, TypeVar

from gateway.common import trust
from gateway.plugin import API, DOORS, Plugin
from gateway_fdi.errors import InputError, nearest

T = TypeVar("T")

#: Our own distribution, whose types no other package can take.
OURS = "ecu-gateway"
#: Group of entry points, each a :class:`Plugin`.
PLUGINS = "gateway.plugins"


def _plugin(place: str) -> Plugin:
    """Import a plug-in.

    Raises:
        InputError: it cannot be imported, is none, or was written for another version.
    """
    found = _load(place)
    if not isinstance(found, Plugin):
        raise InputError(f"no Plugin, but {type(found).__name__}", value=place)
    if found.api != API:
        raise InputError(f"written for version {found.api} of Plugin; this gateway has {API}", value=place)
    return found


def _entries(group: str) -> dict[str, str]:
    """Return name -> place of our own distribution's entry points; none where it is not installed."""
    try:
        found = distribution(OURS).entry_points.select(group=group)
    except PackageNotFoundError:
        return {}
    return {entry.name: entry.value for entry in found}


@cache
def _our_plugins() -> tuple[Plugin, ...]:
    """Return the plug-ins of our own distribution; a package that was taken out brings nothing."""
    places = _entries(PLUGINS).values()
    return tuple(_plugin(place) for place in places if find_spec(place.partition(".")[0]) is not None)


@cache
def _foreign_plugins() -> tuple[dict[str, Plugin], dict[str, InputError]]:
    """Return the plug-ins of other packages by their places, and the errors of those that cannot be used."""
    ours = set(_entries(PLUGINS).values())
    found: dict[str, Plugin] = {}
    wrong: dict[str, InputError] = {}
    for entry in entry_points(group=PLUGINS):
        if entry.value not in ours:
            try:
                found[entry.value] = _plugin(entry.value)
            except InputError as error:
                wrong[entry.name] = error
    return found, wrong


def unusable() -> dict[str, InputError]:
    """Return the plug-ins of other packages that cannot be used, by name, and the reasons."""
    return dict(_foreign_plugins()[1])


@cache
def _ours(group: str) -> dict[str, str]:
    """Return type -> ``package.module:NAME`` of our own distribution."""
    found: dict[str, str] = {}
    for plugin in _our_plugins():
        found |= getattr(plugin, DOORS[group])
    return found | _entries(group)


@cache
def _every(group: str) -> dict[str, list[str]]:
    """Return type -> places, of all packages; to look for them takes a while."""
    found: dict[str, list[str]] = {name: [place] for name, place in _ours(group).items()}
    named = [(entry.name, entry.value) for entry in entry_points(group=group)]
    for plugin in _foreign_plugins()[0].values():
        named += getattr(plugin, DOORS[group]).items()
    for name, place in named:
        places = found.setdefault(name, [])
        if place not in places:
            places.append(place)
    return found


def foreign(group: str) -> list[str]:
    """Return the types of a group that other packages bring."""
    return sorted(_every(group).keys() - _ours(group).keys())


def _load(place: str) -> object:
    """Import ``package.module:NAME``.

    Raises:
        InputError: it is not there, or cannot be imported.
    """
    module, _, name = place.partition(":")
    try:
        found: object = import_module(module)
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # any error of a plug-in while it is imported is one line
        if (why := trust.lacking(error)) is not None:
            raise why from error
        told = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise InputError(f"{module} cannot be imported: {told}", value=place) from error
    for part in name.split("."):
        if not hasattr(found, part):
            raise InputError(f"{module} has no {name}", value=place)
        found = getattr(found, part)
    return found


def accept_callable(found: object, name: str) -> Any:
    """Return a function or a class of another package, for a :class:`Registry` of these.

    Raises:
        InputError: it is none.
    """
    if not callable(found):
        raise InputError(f"no function, but {type(found).__name__}", value=name)
    return found


def accept_instance(kind: type, api: int | None = None) -> Callable[[object, str], Any]:
    """Return a check for a :class:`Registry` of objects: of this class, and written for this version of it."""

    def accept(found: object, name: str) -> Any:
        if not isinstance(found, kind):
            raise InputError(f"no {kind.__name__}, but {type(found).__name__}", value=name)
        version = api if api is None else getattr(found, "api", None)
        if version != api:
            text = f"written for version {version} of {kind.__name__}; this gateway has {api}"
            raise InputError(text, value=name)
        return found

    return accept


class Registry(Mapping[str, T], Generic[T]):
    """Names that a configuration can use, by type.

    Args:
        group: of entry points, type -> ``package.module:NAME``; a key of ``gateway.plugin.DOORS``.
        accept: imported object, its name -> the same, checked.
    """

    def __init__(self, group: str, accept: Callable[[object, str], T]) -> None:
        self.group, self._accept = group, accept
        self._known: dict[str, T] = {}

    @property
    def _own(self) -> Mapping[str, str]:
        return _ours(self.group)

    @property
    def _all(self) -> dict[str, list[str]]:
        return _every(self.group)

    def __getitem__(self, type_: str) -> T:
        """Return what a type stands for.

        Raises:
            KeyError: no package has it.
            InputError: it cannot be imported, is not what it should be, or two packages have it.
        """
        if type_ not in self._known:
            if ":" in type_:  # of a file: it may lie beside that, and not be installed
                module, _, name = type_.partition(":")
                trust.require(module, name)
            place = type_ if ":" in type_ else self._place(type_)
            self._known[type_] = self._accept(_load(place), place)
        return self._known[type_]

    def find(self, type_: str, key: str) -> T:
        """Return what a type stands for that a configuration names.

        Args:
            type_: the type.
            key: path of the table that names it.

        Raises:
            InputError: no package has it; it cannot be imported, is not what it should be, or two packages have it.
        """
        try:
            found = self.get(type_)
            if found is None:
                raise InputError(f"the types are {', '.join(self) or 'none'}{nearest(type_, [*self])}", value=type_)
        except InputError as error:
            of_type = (error.key or "").partition('".')[2]  # which part of the plug-in it is
            text = f"{of_type}: {error.message}" if of_type else error.message
            place = f"{key}.type" if key else "type"
            raise InputError(text, file=error.file, line=error.line, key=place, value=type_) from error
        return found

    def _place(self, type_: str) -> str:
        own = self._own.get(type_)
        places = [own] if own is not None else self._all[type_]
        if len(places) > 1:
            text = f"several installed packages have this type: {', '.join(places)}"
            raise InputError(text, value=type_)
        return places[0]

    def __contains__(self, type_: object) -> bool:
        if not isinstance(type_, str):
            return False
        return ":" in type_ or type_ in self._own or type_ in self._all

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._all))

    def __len__(self) -> int:
        return len(self._all)

    def described(self, types: Iterable[str] | None = None) -> dict[str, T | InputError]:
        """Return types, or all of all installed packages: the object of each, or its error."""
        found: dict[str, T | InputError] = {}
        for type_ in self if types is None else types:
            try:
                found[type_] = self[type_]
            except InputError as error:
                found[type_] = error
        return found
