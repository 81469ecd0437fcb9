"""What may be off of a model: its parameters, and the gain and bias of each sensor.

Each of these is a slow state (:mod:`gateway.fdi.slow.shares`), a share of its bound. A residual's sensitivity to it is
taken from the generator's own code: beside the generator runs one whose parameter is off by :data:`STEP` of its bound,
or whose sensor's reading is corrected by as much, and the difference of their residuals over :data:`STEP` is the
sensitivity. So it holds for any model that a generator can be written for, and along the drive, states and filters
with it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from gateway.errors import InputError, nearest
from gateway.fdi.slow.shares import MOST_SLOW
from gateway.fdi.structure.generator.records import field_name
from gateway.fdi.structure.model import Model
from gateway.fdi.structure.model import Quantity as Known
from gateway.fdi.structure.units import differ
from gateway.monitors.structural.params import Params
from gateway.monitors.structural.plan import Test

#: Share of its bound by which the neighbour of a generator is off.
STEP = 0.1


class Slow(NamedTuple):
    """One slow state.

    Attributes:
        kind: ``parameter``, ``gain`` or ``bias``.
        name: of the parameter, or of the known variable.
        bound: share of the parameter's value, or of the sensor's gain; bias in the known variable's unit.
    """

    kind: str
    name: str
    bound: float

    @property
    def field(self) -> str:
        """Field of the state that shows it."""
        tail = "" if self.kind == "parameter" else f"_{self.kind}"
        return f"off_{field_name(self.name)}{tail}"

    @property
    def text(self) -> str:
        """It in words."""
        return self.name if self.kind == "parameter" else f"{self.kind} of {self.name}"


def slow_of(model: Model, p: Params) -> tuple[Slow, ...]:
    """Return the slow states that a configuration asks for.

    Raises:
        InputError: a name that the model does not have, a bias in another unit, or too many of them.
    """
    found = []
    for name, share in p.uncertain.items():
        if name not in model.parameters:
            text = f"the parameters are {', '.join(model.parameters)}{nearest(name, model.parameters)}"
            raise InputError(text, key=f"uncertain.{name}", value=name)
        found.append(Slow("parameter", name, share))
    for name, sensor in p.sensors.items():
        if name not in model.knowns:
            text = f"the known variables are {', '.join(model.knowns)}{nearest(name, model.knowns)}"
            raise InputError(text, key=f"sensors.{name}", value=name)
        unit = model.quantities.get(name, Known()).unit
        if sensor.bias is not None and differ(sensor.bias.unit, unit):
            text = f'{name} of the model is in "{unit}"'
            raise InputError(text, key=f"sensors.{name}.bias", value=str(sensor.bias))
        if sensor.gain:
            found.append(Slow("gain", name, sensor.gain))
        if sensor.bias is not None and sensor.bias.value:
            found.append(Slow("bias", name, sensor.bias.value))
    if len(found) > MOST_SLOW:
        text = f"{len(found)} parameters, gains and biases that may be off: a monitor has room for {MOST_SLOW}"
        raise InputError(text, key="uncertain")
    return tuple(found)


def acts_on(slow: Slow, test: Test) -> bool:
    """Tell whether a test's residual depends on what may be off."""
    if slow.kind == "parameter":
        return re.search(rf"\bc\.{field_name(slow.name)}\b", test.source) is not None
    return slow.name in test.knowns


def neighbours(slow: Sequence[Slow], test: Test) -> list[int]:
    """Return the slow states that act on a test, by their numbers: it has a neighbour for each."""
    return [j for j, one in enumerate(slow) if acts_on(one, test)]
