"""A function or a class as its author wrote it: which of its arguments are inputs, and which are parameters."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, get_type_hints

from pydantic import create_model

from gateway.monitors.contract import MonitorParams, Signal
from gateway_fdi.errors import InputError, nearest

#: Keys of a table ``[[monitor]]`` that are the gateway's own.
OWN_KEYS = ("name", "type", "bus", "priority", "send", "signals", "trusted")
#: Arguments that the gateway fills itself: time of the event, and time since the step before (0 in the first) [s].
TIMES = ("t_s", "dt_s")
_SIGNAL = re.compile(r"(?P<name>[^\s\[]+)(?:\s*\[(?P<unit>[^\]]*)\])?")


@dataclass(frozen=True)
class Written:
    """Code of an author.

    Attributes:
        made: a function, or a class with ``update``.
        inputs: argument -> its signal, in the order of the inputs.
        arguments: of a step, in order: inputs and TIMES.
        params: pydantic model of the parameters.
        file, line: where it stands.
    """

    made: Any
    inputs: Mapping[str, Signal]
    arguments: tuple[str, ...]
    params: type[MonitorParams]
    file: Path
    line: int

    @property
    def name(self) -> str:
        """Its name."""
        return str(self.made.__name__)

    @property
    def text(self) -> str:
        """Its first sentence for people; without one, its name."""
        told = inspect.cleandoc(self.made.__doc__ or "")
        own = not told or told.startswith(f"{self.name}(")  # a dataclass' own text
        return self.name.replace("_", " ") if own else told.partition("\n")[0].rstrip(".")

    def instance(self, params: MonitorParams) -> Callable[..., Any]:
        """Return a function that takes a step's arguments, with these parameters."""
        given = {name: getattr(params, name) for name in self.params.model_fields}
        made = self.made
        if isinstance(made, type):
            updated: Callable[..., Any] = getattr(made(**given), "update")  # noqa: B009 - of any class
            return updated
        if not given:
            return made  # type: ignore[no-any-return]
        return lambda *values: made(*values, **given)


def read(made: Any, signals: Sequence[str | Signal] | Mapping[str, str | Signal]) -> Written:
    """Read a function, or a class with ``update``.

    Args:
        made: it.
        signals: of the first arguments, in order; or of arguments by name. ``"Message.Signal [unit]"`` each.

    Raises:
        InputError: it is neither, or its arguments do not go with the signals.
    """
    if not (inspect.isclass(made) or inspect.isfunction(made)):
        raise InputError("@monitor stands before a function, or a class with update", value=repr(made))
    update = getattr(made, "update", None)
    code = update if inspect.isclass(made) and inspect.isfunction(update) else made
    file = Path(inspect.getfile(made))
    line = inspect.unwrap(code).__code__.co_firstlineno if not inspect.isclass(code) else None

    def refuse(text: str) -> NoReturn:
        raise InputError(text, file=file, line=line, key=f"@monitor {made.__name__}")

    if not isinstance(signals, Mapping | list | tuple):
        refuse(f"signals is a list of them, or a dictionary by argument, not {signals!r}")
    if inspect.isclass(code):
        refuse("a class needs a function update(self, ...): it is called with each sample")
    taken = list(inspect.signature(code).parameters.values())[1 if inspect.isclass(made) else 0 :]
    if any(one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD) for one in taken):
        refuse("its arguments have names: no *args, no **kwargs")
    named = isinstance(signals, Mapping)
    positional = [one.name for one in taken if one.kind is not one.KEYWORD_ONLY and one.name not in TIMES]
    names = [str(name) for name in signals] if named else positional[: len(signals)]
    if named and (wrong := next((name for name in names if name not in positional), None)) is not None:
        refuse(f"signals: there is no argument {wrong!r}{nearest(wrong, positional)}")
    if len(names) < len(signals) or not names:
        refuse(f"{len(signals)} signals, and {len(positional)} arguments that could take them")
    rest = [one for one in taken if one.name not in names and one.name not in TIMES]
    if inspect.isclass(made):
        if rest:
            refuse(f"update has the argument {rest[0].name!r}, and signals have none for it")
        rest = list(inspect.signature(made).parameters.values())
    inputs = {}
    for name, given in zip(names, signals.values() if isinstance(signals, Mapping) else signals, strict=True):
        inputs[name] = given if isinstance(given, Signal) else signal(given, refuse)
    arguments = tuple(one.name for one in taken if one.name in names or one.name in TIMES)
    return Written(made, inputs, arguments, _params(made, rest, refuse), file, line or 1)


def signal(text: object, refuse: Callable[[str], NoReturn]) -> Signal:
    """Return the signal that ``"Message.Signal [unit]"`` names; it triggers.

    Args:
        text: as it is written.
        refuse: raises an error that says what else was expected.
    """
    found = _SIGNAL.fullmatch(text) if isinstance(text, str) else None
    if found is None or "." not in found["name"]:
        refuse(f'"Message.Signal" or "Message.Signal [unit]", not {text!r}')
    return Signal(found["name"], unit=found["unit"], triggers=True)


def _params(made: Any, rest: Sequence[inspect.Parameter], refuse: Callable[[str], NoReturn]) -> type[MonitorParams]:
    try:
        hints = get_type_hints(made.__init__ if inspect.isclass(made) else made, include_extras=True)
    except NameError as error:
        refuse(f"a type is not known: {error}")
    fields: dict[str, Any] = {}
    for one in rest:
        if one.name not in hints:
            refuse(f"the parameter {one.name!r} needs a type: {one.name}: float = 1.0")
        if one.name.startswith("_") or one.name in OWN_KEYS or hasattr(MonitorParams, one.name):
            refuse(f"a parameter cannot be called {one.name!r}")
        fields[one.name] = (hints[one.name], ... if one.default is one.empty else one.default)
    try:
        return create_model(f"{made.__name__}_params", __base__=MonitorParams, **fields)
    except Exception as error:  # pydantic has several of its own
        return refuse(f"the parameters {', '.join(fields)}: {' '.join(str(error).split())}")
