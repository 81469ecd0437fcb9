"""Old name of :mod:`gateway_api`, until version 2."""

from __future__ import annotations

from importlib import import_module
from typing import Any
from warnings import warn


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    warn("gateway.api is gateway_api now", DeprecationWarning, stacklevel=2)
    return getattr(import_module("gateway_api"), name)
