"""Fault detection and isolation: mathematics that knows no bus; a library of its own.

::

    from gateway_fdi import Residual, load_model

    residual = Residual(load_model("models/tanks.toml"), "1:e3")
    r = residual.run(t_s, {"u": u, "y1": y1, "y2": y2, "y3": y3})

All names in ``__all__`` are stable, as those of :mod:`gateway_api` are. Each name is imported when it is first used: a
daemon that wants one of them loads no other.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gateway_fdi.detectors import Cusum, StoppingRule
    from gateway_fdi.diagnosis.diagnoser import Diagnoser
    from gateway_fdi.diagnosis.state import FAILED, PASSED, Sized
    from gateway_fdi.diagnosis.system import Component, Link, Test
    from gateway_fdi.errors import GatewayError, InputError, InputErrors
    from gateway_fdi.residual import Residual, residuals
    from gateway_fdi.structure.analysis import Analysis, analyse
    from gateway_fdi.structure.file import load_model
    from gateway_fdi.structure.model import Model

__all__ = [
    "FAILED",
    "PASSED",
    "Analysis",
    "Component",
    "Cusum",
    "Diagnoser",
    "GatewayError",
    "InputError",
    "InputErrors",
    "Link",
    "Model",
    "Residual",
    "Sized",
    "StoppingRule",
    "Test",
    "analyse",
    "load_model",
    "residuals",
]

_PLACES = {
    "detectors": ("Cusum", "StoppingRule"),
    "diagnosis.diagnoser": ("Diagnoser",),
    "diagnosis.state": ("FAILED", "PASSED", "Sized"),
    "diagnosis.system": ("Component", "Link", "Test"),
    "errors": ("GatewayError", "InputError", "InputErrors"),
    "residual": ("Residual", "residuals"),
    "structure.analysis": ("Analysis", "analyse"),
    "structure.file": ("load_model",),
    "structure.model": ("Model",),
}


def __getattr__(name: str) -> Any:
    """Import a public name where it is used first."""
    for module, names in _PLACES.items():
        if name in names:
            return getattr(import_module(f"gateway_fdi.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
