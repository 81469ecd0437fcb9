"""Records of generated residual generators: the names of their fields, and how constants are filled from a model."""

from __future__ import annotations

import keyword
from collections.abc import Mapping
from typing import Any

import numpy as np

from gateway_fdi.structure.model import Model, Quantity
from gateway_fdi.structure.relation import identifier

#: Fields of Const for the filters [rad/s].
FILTER, DIFFERENTIATOR = "filter_bandwidth", "derivative_bandwidth"
#: Field of State for the gain of a fault, filtered as the residual is, where its size is asked for.
GAIN = "gain_"
#: Fields of State for the Jacobian of states that act on each other, before a number: of each such group.
JACOBIAN = "jacobian_"
#: Fields of Const for the correction of a state, and of its derivative, by the residual, before the state's name.
FEED, FEED_SLOPE = "feed_", "feed_slope_"
#: And of their step: slopes, their change, the moves; functions of the Jacobian; 1 where there are no derivatives.
SLOPES, HOLD, DEAD = "slopes_", "hold_", "dead_"


#: Names that the records of a residual generator are written with.
_WRITTEN = ("Annotated", "f8", "f8s", "means")


def field_name(name: str) -> str:
    """Return the name of a record's field: one that records of NumPy do not have already."""
    name = identifier(name)
    return f"{name}_" if hasattr(np.record, name) or keyword.iskeyword(name) or name in _WRITTEN else name


def fill(
    c: Any,
    model: Model,
    *,
    values: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    filter_bandwidth: float = 0.5,
    derivative_bandwidth: float = 10.0,
) -> None:
    """Fill the constants of a residual generator that was written from a model.

    Args:
        c: record of its Const.
        values: values of parameters instead of the model's.
        start: start values of states instead of the model's.
        filter_bandwidth: alpha of (20) [rad/s].
        derivative_bandwidth: of the filters that differentiate [rad/s].

    Raises:
        ValueError: a parameter has no value, or there is no such parameter.
    """
    given, begins = dict(values or {}), dict(start or {})
    for name in given:
        if name not in model.parameters:
            raise ValueError(f'"{name}" is no parameter of {model.name}')
    names = set(c.dtype.names or ())
    for name in (*model.parameters, *model.states):
        field = field_name(name) if name in model.parameters else f"start_{field_name(name)}"
        if field in names:
            own = model.quantities.get(name, Quantity()).value
            value = given.get(name, begins.get(name, own))
            if value is None:
                raise ValueError(f'"{name}" of {model.name} has no value')
            c[field] = value
    for name, points in model.tables.items():
        if f"{field_name(name)}_x" in names:
            c[f"{field_name(name)}_x"], c[f"{field_name(name)}_y"] = points.x, points.y
    for name, value in ((FILTER, filter_bandwidth), (DIFFERENTIATOR, derivative_bandwidth)):
        if name in names:
            if not value > 0:
                raise ValueError(f"{name} = {value}: must be positive")
            c[name] = value
