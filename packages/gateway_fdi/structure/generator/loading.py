"""Residual generators compiled."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import f8, record
from gateway_fdi.structure.generator.code import Generated, write
from gateway_fdi.structure.generator.realisation import realise
from gateway_fdi.structure.generator.records import field_name, fill
from gateway_fdi.structure.generator.sources import load_source, module_name
from gateway_fdi.structure.model import Model


@dataclass(frozen=True)
class Loaded:
    """A residual generator that runs.

    Attributes:
        generated: the code and its statements.
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

    def prepare(self, c: np.void, *, values: Mapping[str, float] | None = None, **bandwidths: float) -> None:
        """Fill a record of the constants, as :func:`.records.fill` does; carried states begin at their values."""
        realisation = self.generated.realisation
        fill(c, realisation.model, values=values, start=realisation.carried, **bandwidths)

    def over(self, s: np.void, c: np.void, rows: NDArray[np.void], steps_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the residual of samples, and advance the states.

        Args:
            s: states, begun.
            c: constants.
            rows: of ``inputs``, shape (n,).
            steps_s: since the sample before, shape (n,) [s].
        """
        made = load_source(f"{self.generated.name} over samples", _OVER.format(module_name(self.generated.source)))
        found = np.empty(len(rows))
        made.over(s, c, rows, steps_s, found)
        return found


_OVER = '''"""A residual generator over samples."""

from typing import Any

import {} as generator
from gateway_fdi.jit import kernel


@kernel
def over(s: Any, c: Any, u: Any, dt: Any, found: Any) -> None:
    for k in range(len(found)):
        found[k] = generator.step(s, c, u[k], dt[k])
'''


def load(generated: Generated) -> Loaded:
    """Compile generated code (when it is called for the first time)."""
    module = load_source(generated.name, generated.source)
    fields = {field_name(name): f8 for name in (*generated.knowns, *generated.rates)}
    return Loaded(
        generated,
        module.State.dtype,
        module.Const.dtype,
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
    realisation = realise(model, equations, consistency, differentiate=differentiate, start=start, outputs=outputs)
    return load(write(name or consistency, realisation))
