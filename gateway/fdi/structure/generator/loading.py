"""Generated code compiled: a module in the cache of kernels, found again by its text."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from gateway.fdi.structure.generator.code import Generated, write
from gateway.fdi.structure.generator.realisation import realise
from gateway.fdi.structure.generator.records import field_name, fill
from gateway.fdi.structure.model import Model
from gateway.jit import CACHE, f8, record


@dataclass(frozen=True)
class Loaded:
    """A residual generator that runs.

    Attributes:
        generated: the code and what it does.
        state: dtype of its states.
        const: dtype of its constants.
        inputs: dtype with a field for each known variable, and for each rate that a start needs.
        reset: kernel (s, c).
        start: kernel (s, c, u).
        step: kernel (s, c, u, dt), returns the residual.
    """

    generated: Generated
    state: np.dtype[np.void]
    const: np.dtype[np.void]
    inputs: np.dtype[np.void]
    reset: Callable[[Any, Any], None]
    start: Callable[[Any, Any, Any], None]
    step: Callable[[Any, Any, Any, float], float]

    def prepare(
        self,
        c: np.void,
        *,
        values: Mapping[str, float] | None = None,
        filter_bandwidth: float = 0.5,
        derivative_bandwidth: float = 10.0,
    ) -> None:
        """Fill a record of the constants.

        Args:
            c: the record.
            values: values of parameters instead of the model's.
            filter_bandwidth: alpha of (20) [rad/s].
            derivative_bandwidth: of the filters that differentiate [rad/s].

        Raises:
            ValueError: a parameter has no value, or there is no such parameter.
        """
        realisation = self.generated.realisation
        fill(
            c,
            realisation.model,
            values=values,
            start=realisation.carried,
            filter_bandwidth=filter_bandwidth,
            derivative_bandwidth=derivative_bandwidth,
        )


def load_source(name: str, source: str) -> ModuleType:
    """Return generated code as a module; it lies in the cache, so that its kernels are compiled once."""
    digest = hashlib.blake2b(source.encode(), digest_size=8).hexdigest()
    label = f"gateway_generated_{digest}"
    if label in sys.modules:
        return sys.modules[label]
    folder = CACHE / "generated"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{label}.py"
    if not path.exists():
        draft = folder / f"{label}.{os.getpid()}"
        draft.write_text(source, encoding="utf-8")
        draft.replace(path)  # whoever else makes the same finds all of it, or nothing
    specification = importlib.util.spec_from_file_location(label, path)
    if specification is None or specification.loader is None:
        raise ValueError(f"{name}: no module can be made of {path}")
    module = importlib.util.module_from_spec(specification)
    sys.modules[label] = module
    try:
        specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[label]
        raise
    return module


def load(generated: Generated) -> Loaded:
    """Compile generated code (when it is called for the first time)."""
    module = load_source(generated.name, generated.source)
    fields = {field_name(name): f8 for name in (*generated.knowns, *generated.rates)}
    return Loaded(
        generated,
        module.STATE,
        module.CONST,
        record(**(fields or {"unused_": f8})),
        module.reset,
        module.start,
        module.step,
    )


def residual_generator(
    model: Model,
    equations: frozenset[str],
    consistency: str,
    *,
    name: str = "",
    differentiate: bool = False,
    start: Mapping[str, float] | None = None,
    outputs: Sequence[str] = (),
) -> Loaded:
    """Return a residual generator of a model that runs (see :func:`realise` for the arguments and errors)."""
    realisation = realise(
        model, equations, consistency, differentiate=differentiate, start=start, outputs=outputs
    )
    return load(write(name or consistency, realisation))
