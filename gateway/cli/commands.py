"""Commands of other packages: entry points of the group ``gateway.commands``, each a ``typer.Typer`` or a function.

Our own studies come through this door.
"""

import sys
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperGroup

from gateway.common.plugins import Registry
from gateway.errors import InputError

#: Commands that packages of this project bring -> how to get them.
ELSEWHERE = {"evaluate": "the studies are a package of their own; in a checkout: pip install ./studies"}


def _accepted(found: object, name: str) -> typer.Typer | Callable[..., Any]:
    if not isinstance(found, typer.Typer) and not callable(found):
        raise InputError(f"no typer.Typer and no function, but {type(found).__name__}", value=name)
    return found


_OTHERS: Registry[typer.Typer | Callable[..., Any]] = Registry("gateway.commands", _accepted, own={})


def _command(found: typer.Typer | Callable[..., Any], name: str) -> Any:
    """Return what typer makes of it."""
    if not isinstance(found, typer.Typer):
        app = typer.Typer(rich_markup_mode=None, add_completion=False)
        app.command(name)(found)
        found = app
    made = typer.main.get_command(found)
    made.name = name
    return made


class Commands(TyperGroup):
    """Our commands, and those of installed packages after them; ours are looked up first."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        ours = super().list_commands(ctx)
        return [*ours, *(name for name in sorted(_OTHERS) if name not in ours)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, None if there is none."""
        found = super().get_command(ctx, cmd_name)
        if found is not None or ":" in cmd_name:
            return found
        if cmd_name not in _OTHERS:
            if cmd_name in ELSEWHERE:
                raise InputError(ELSEWHERE[cmd_name], value=f"gateway {cmd_name}")
            return None
        try:
            self.commands[cmd_name] = _command(_OTHERS[cmd_name], cmd_name)
        except InputError as error:
            if "--help" in sys.argv[1:2] or len(sys.argv) == 1:  # the others are listed
                typer.echo(f"gateway {cmd_name}: {error}", err=True)
                return None
            raise
        return self.commands[cmd_name]
