"""Commands of other packages: by a plug-in, or an entry point of the group ``gateway.commands``.

Each is a ``typer.Typer`` or a function. The commands of the bench, the fleet and the plants come through this door.
"""

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Annotated, Any, ClassVar, get_args

import typer
from typer.core import TyperGroup
from typer.models import ArgumentInfo

from gateway.cli.failure import asked_for
from gateway.common.plugins import Registry
from gateway.common.trust import trust_all
from gateway_fdi.errors import InputError, InputErrors


def _accepted(found: object, name: str) -> typer.Typer | Callable[..., Any]:
    if not isinstance(found, typer.Typer) and not callable(found):
        raise InputError(f"no typer.Typer and no function, but {type(found).__name__}", value=name)
    return found


#: Commands of other packages, by name.
OTHERS: Registry[typer.Typer | Callable[..., Any]] = Registry("gateway.commands", _accepted)

#: Section of ``gateway --help``, with an example -> its commands, in order; others follow by name in the last one.
SECTIONS = {
    "Run (gateway run gateway.toml --serve)": (
        "demo", "run", "serve", "watch", "request", "record", "mqtt", "check", "trust", "doctor", "schema", "warmup",
    ),
    "Car (gateway learn car.dbc drive.log -o car.toml)": (
        "learn", "replay", "decode", "plot", "convert", "survey", "import", "fleet",
    ),
    "Faults (gateway faults list)": ("faults", "report"),
    "Bench (gateway simulate scenarios/crank/crank_missed_tooth.toml)": ("example", "simulate", "control", "bus"),
    "Research (gateway evaluate cause)": ("evaluate", "calibrate", "fit", "structure", "new-monitor"),
    "Others": (),
}  # fmt: skip
ORDER = tuple(name for names in SECTIONS.values() for name in names)


def _command(found: typer.Typer | Callable[..., Any], name: str) -> Any:
    """Return what typer makes of it."""
    if not isinstance(found, typer.Typer):
        app = typer.Typer(rich_markup_mode=None, add_completion=False)
        app.command(name)(found)
        found = app
    made = typer.main.get_command(found)
    made.name = name
    return made


def _trust_all(wanted: bool) -> None:
    if wanted:
        trust_all()


def _only_trust(
    trust: Annotated[
        bool,
        typer.Option(
            "--trust",
            help="Run all code that the files name, without asking (gateway trust).",
            callback=_trust_all,
            expose_value=False,
        ),
    ] = False,
) -> None:
    """Take the option that other commands get. typer makes it: the class of options changes with its versions."""


def _trusting(command: Any) -> Any:
    """Give a command the option that takes all code that its files name."""
    several = command is None or isinstance(command, TyperGroup) or command.name == "trust"
    if not several and not any("--trust" in option.opts for option in command.params):
        command.params += [option for option in _command(_only_trust, "").params if "--trust" in option.opts]
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

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, of ``gateway`` by sections."""
        if self.words:
            super().format_commands(ctx, formatter)
            return
        there = self.list_commands(ctx)
        for title, names in SECTIONS.items():
            mine = names or [name for name in there if name not in ORDER]
            found = [(name, self.get_command(ctx, name)) for name in mine if name in there]
            room = formatter.width - 6 - max((len(name) for name in there), default=0)
            rows = [(name, one.get_short_help_str(room)) for name, one in found if one is not None and not one.hidden]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

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
        words = {name: _written(name, form) for name, form in command.__annotations__.items() if name != "return"}
        lists = [name for name, form in command.__annotations__.items() if "list[" in str(get_args(form)[:1])]

        @wraps(command)
        def call(**given: Any) -> None:
            given |= {name: () for name in lists if given[name] is None}
            module, _, function = place.partition(":")
            try:
                work = getattr(import_module(module), function)
                code = work(**{renamed.get(name, name): value for name, value in given.items()})
            except BrokenPipeError:
                raise
            except (InputError, InputErrors, OSError) as error:
                raise asked_for(error, {words[name]: value for name, value in given.items()}) from error
            raise typer.Exit(code)

        return call

    return decorated


def _written(name: str, form: Any) -> str:
    """Return an option or argument as people write it."""
    _, info = get_args(form)
    flags = [flag for flag in info.param_decls or () if flag.startswith("--")]
    if isinstance(info, ArgumentInfo):
        return name
    return flags[0] if flags else f"--{name.replace('_', '-')}"


def group(name: str, text: str, renamed: dict[str, str] | None = None) -> typer.Typer:
    """Return a group of commands to which other packages can add theirs, as ``"NAME COMMAND"``.

    Args:
        name: of the group.
        text: its help.
        renamed: commands that were called otherwise before.
    """
    kind = type("Group", (Commands,), {"words": f"{name} ", "renamed": renamed or {}})
    return typer.Typer(cls=kind, help=text, no_args_is_help=True, rich_markup_mode=None, add_completion=False)
