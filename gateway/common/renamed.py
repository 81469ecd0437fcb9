"""Old names of modules that people import: they warn, and give what is there now."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any
from warnings import warn


def renamed(old: str, new: str) -> Callable[[str], Any]:
    """Return the function ``__getattr__`` of a module that is called otherwise now, until version 2."""

    def get(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        warn(f"{old} is {new} now", DeprecationWarning, stacklevel=2)
        return getattr(import_module(new), name)

    return get
