"""Errors and notes in the words of a caller from Python: arguments instead of options of the command line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from gateway_fdi.errors import InputError, InputErrors, each_of

_OPTIONS = {
    "--map": "maps",
    "--inject": "inject",
    "--signals": "series",
    "--signal": "signals",
    "--memory": "memory",
    "--write-to": "into",
    "--force": "overwrite=True",
    "--update": "update=True",
    "--allow-empty": "allow_empty=True",
    "--allow-cut": "allow_cut=True",
    "LOG": "logs",
    "DATABASE": "databases",
}
_PAIR = re.compile(r"--map (\S+=[^\s)]+)")
_OPTION = re.compile(r"--[a-z-]+")


def plain(text: str) -> str:
    """Return a text with the options that it names as arguments."""
    text = _PAIR.sub(r'maps=["\1"]', text)
    return _OPTION.sub(lambda found: _OPTIONS.get(found[0], found[0]), text)


def _spoken(error: InputError) -> InputError:
    key = error.key if error.key is None else _OPTIONS.get(error.key, error.key)
    return InputError(plain(error.message), file=error.file, line=error.line, key=key, value=error.value)


@contextmanager
def spoken() -> Iterator[None]:
    """Raise the errors within in the caller's words.

    Raises:
        InputError, InputErrors: the error raised within, reworded.
    """
    try:
        yield
    except (InputError, InputErrors) as error:
        found = [_spoken(one) for one in each_of(error)]
        raise (InputErrors(found) if isinstance(error, InputErrors) else found[0]) from error
