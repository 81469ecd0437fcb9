"""Commands of other packages: by a plug-in, or an entry point of the group ``gateway.commands``.

Each is a ``typer.Typer`` or a function. The commands of the bench, the fleet and the plants come through this door.
"""

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any, ClassVar, get_args

import typer
from typer.core import TyperGroup, TyperOption

from gateway.common.plugins import Registry
from gateway.common.trust import trust_all
from gateway_fdi.errors import InputError


def _accepted(found: object, name: str) -> typer.Typer | Callable[..., Any]:
    if not isinstance(found, typer.Typer) and not callable(found):
        raise InputError(f"no typer.Typer and no function, but {type(found).__name__}", value=name)
    return found


#: Commands of other packages, by name.
OTHERS: Registry[typer.Typer | Callable[..., Any]] = Registry("gateway.commands", _accepted)

#: The order in which ``gateway --help`` lists commands; others follow by name.
ORDER = (
    "demo", "run", "serve", "watch", "mqtt", "request", "simulate", "control", "report", "structure", "learn", "import",
    "survey", "calibrate", "fit", "bus", "record", "replay", "decode", "plot", "check", "example", "new-monitor",
    "trust", "warmup", "doctor", "faults", "convert", "fleet", "evaluate",
)  # fmt: skip


def _command(found: typer.Typer | Callable[..., Any], name: str) -> Any:
    """Return what typer makes of it."""
    if not isinstance(found, typer.Typer):
        app = typer.Typer(rich_markup_mode=None, add_completion=False)
        app.command(name)(found)
        found = app
    made = typer.main.get_command(found)
    made.name = name
    return made


def _trust_all(_context: Any, _option: Any, wanted: bool) -> None:
    if wanted:
        trust_all()


def _trusting(command: Any) -> Any:
    """Give a command the option that takes all code that its files name."""
    several = command is None or isinstance(command, TyperGroup) or command.name == "trust"
    if not several and not any("--trust" in option.opts for option in command.params):
        text = "Run all code that the files name, without asking (gateway trust)."
        option = TyperOption(
            param_decls=["--trust"], is_flag=True, default=False, expose_value=False, callback=_trust_all, help=text
        )
        command.params.append(option)
    return command


class Commands(TyperGroup):
    """Our commands, and those of other packages after them; ours are looked up first.

    Attributes:
        words: the words before a command of this group, each with a space after it; "": the commands of ``gateway``.
        renamed: commands that were called otherwise before.
    """

    words = ""
    renamed: ClassVar[dict[str, str]] = {}

    def _others(self) -> dict[str, str]:
        """Return name in this group -> name among all."""
        names = {name.removeprefix(self.words): name for name in OTHERS if name.startswith(self.words)}
        return {name: whole for name, whole in names.items() if " " not in name}

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        names = {*super().list_commands(ctx), *self._others()}
        if self.words:
            return sorted(names)
        first = [name for name in ORDER if name in names]
        return [*first, *sorted(names.difference(first))]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, None if there is none."""
        if cmd_name in self.renamed:
            now = self.renamed[cmd_name]
            typer.echo(f"gateway {self.words}{cmd_name} is {now} now", err=True)
            cmd_name = now
        found = super().get_command(ctx, cmd_name)
        whole = self.words + cmd_name
        if found is not None or ":" in cmd_name or " " in cmd_name or whole not in OTHERS:
            return _trusting(found)
        try:
            self.commands[cmd_name] = _trusting(_command(OTHERS[whole], cmd_name))
        except InputError as error:
            if "--help" in sys.argv[1:2] or len(sys.argv) == 1:  # the others are listed
                typer.echo(f"gateway {whole}: {error}", err=True)
                return None
            raise
        return self.commands[cmd_name]


def does(place: str, **renamed: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator: the command calls a function, imported when it is called, and exits with its exit code.

    The function gets all options by their names; a list that was not given is empty.

    Args:
        place: ``module:function``.
        renamed: option -> parameter of the function, where they differ.
    """

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        lists = [name for name, form in command.__annotations__.items() if "list[" in str(get_args(form)[:1])]

        @wraps(command)
        def call(**given: Any) -> None:
            given |= {name: () for name in lists if given[name] is None}
            module, _, function = place.partition(":")
            work = getattr(import_module(module), function)
            raise typer.Exit(work(**{renamed.get(name, name): value for name, value in given.items()}))

        return call

    return decorated


def group(name: str, text: str, renamed: dict[str, str] | None = None) -> typer.Typer:
    """Return a group of commands to which other packages can add theirs, as ``"NAME COMMAND"``.

    Args:
        name: of the group.
        text: its help.
        renamed: commands that were called otherwise before.
    """
    kind = type("Group", (Commands,), {"words": f"{name} ", "renamed": renamed or {}})
    return typer.Typer(cls=kind, help=text, no_args_is_help=True, rich_markup_mode=None, add_completion=False)
