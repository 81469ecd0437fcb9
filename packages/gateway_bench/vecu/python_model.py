"""A class of the user as a virtual ECU: ``type = "package.module:Class"``, or an entry point that names a class.

The class is made with the scenario's ``parameters`` as arguments (and ``rng``, if it takes one). It has
``step(t, inputs) -> outputs``: the time [s] and a dict of the inputs, a dict of the outputs at that time; it uses these
inputs until its next step.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from gateway_bench.vecu.contract import API, Run, Running, VirtualEcu
from gateway_bench.vecu.loop import Loop, Model, sends
from gateway_bench.vecu.loop_params import LoopFault, LoopParams, fits
from gateway_fdi.common.tomlfile import key_path
from gateway_fdi.errors import GatewayError, InputError, nearest


class _Instance:
    """An object of the user's class; its errors are told in one line, with the place in its own file."""

    def __init__(self, made: Any) -> None:
        self._made = made

    def step(self, t: float, inputs: Mapping[str, float]) -> Mapping[str, float]:
        try:
            said = self._made.step(t, dict(inputs))
        except Exception as error:  # any error of a user's class
            raise InputError(f"step at {t:.4f} s: {_text_of(error)}", value=type(self._made).__name__) from error
        if not isinstance(said, Mapping):
            text = f"step at {t:.4f} s returned {type(said).__name__}, not a dict of outputs"
            raise InputError(text, value=type(self._made).__name__)
        return said

    def close(self) -> None:
        close = getattr(self._made, "close", None)
        if callable(close):
            close()


def _text_of(error: Exception) -> str:
    if isinstance(error, GatewayError):
        return str(error)
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename}:{frames[-1].lineno})" if len(frames) > 1 else ""
    return f"{type(error).__name__}: {error}{where}"


def _made(class_: type, params: LoopParams, run: Run) -> Model:
    """Return an object of the class.

    Raises:
        InputError: parameters that it does not take, or lacks; any error that it raises.
    """
    try:
        wanted = inspect.signature(class_).parameters
    except ValueError:  # a class made in C says nothing
        wanted = inspect.signature(lambda **_: None).parameters
    takes_all = any(each.kind is inspect.Parameter.VAR_KEYWORD for each in wanted.values())
    for name in params.parameters:
        if name not in wanted and not takes_all:
            known = [each for each in wanted if each != "rng"]
            text = f"{class_.__name__} takes {', '.join(known) or 'nothing'}{nearest(name, known)}"
            raise InputError(text, key=key_path(("parameters", name)), value=name)
    for name, each in wanted.items():
        several = each.kind in (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
        if each.default is inspect.Parameter.empty and not several and name not in (*params.parameters, "rng"):
            raise InputError(f"{class_.__name__} wants this parameter", key=key_path(("parameters", name)))
    more: dict[str, Any] = {"rng": run.rng} if "rng" in wanted else {}
    try:
        return _Instance(class_(**params.parameters, **more))
    except Exception as error:  # any error of a user's class
        raise InputError(f"{class_.__name__} cannot be made: {_text_of(error)}", key="parameters") from error


def _begin(class_: type, params: LoopParams, faults: Sequence[LoopFault], run: Run) -> Running:
    return Loop(params, faults, run, lambda: _made(class_, params, run))


def is_model(found: object) -> bool:
    """Tell a class that can be in a loop."""
    return isinstance(found, type) and callable(getattr(found, "step", None))


def ecu_of(class_: type) -> VirtualEcu[LoopParams, LoopFault]:
    """Return the virtual ECU that a class is."""
    return VirtualEcu(
        type=class_.__name__,
        api=API,
        params=LoopParams,
        fault=LoopFault,
        begin=partial(_begin, class_),
        sends=sends,
        fits=fits,
        step_ns=1_000_000,
    )
