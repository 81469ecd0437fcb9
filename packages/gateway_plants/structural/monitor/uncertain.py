"""What may be off of a model: its parameters, and the gain, bias and lag of each sensor.

Each of these is a slow state (:mod:`gateway_fdi.slow.filter`), a share of its bound. A residual's sensitivity to it is
taken from the generator's own code: beside the generator runs one whose parameter is off by :data:`STEP` of its bound,
or whose sensor's reading is corrected by as much, and the difference of their residuals over :data:`STEP` is the
sensitivity. So it holds for any model that a generator can be written for, and along the drive, states and filters
with it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from gateway_fdi.errors import Gathered, InputError, nearest
from gateway_fdi.slow import delay
from gateway_fdi.slow.filter import MOST as MOST_SLOW
from gateway_fdi.structure.generator.records import field_name
from gateway_fdi.structure.model import Model
from gateway_fdi.structure.model import Quantity as Known
from gateway_fdi.structure.units import differ
from gateway_plants.structural.monitor.params import Params
from gateway_plants.structural.monitor.plan import Test

#: Share of its bound by which the neighbour of a generator is off.
STEP = 0.1


class Slow(NamedTuple):
    """One slow state.

    Attributes:
        kind: ``parameter``, ``gain``, ``bias`` or ``lag``.
        name: of the parameter, or of the known variable.
        bound: share of the parameter's value, or of the sensor's gain; bias in the known variable's unit, lag in ms.
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
        InputError, InputErrors: names that the model does not have, a bias in another unit, or too many of them.
    """
    found: list[Slow] = []
    wrong = Gathered()
    for name, share in p.uncertain.items():
        with wrong:
            check_name(name, model.parameters, "parameters", f"uncertain.{name}")
            found.append(Slow("parameter", name, share))
    for name, sensor in p.sensors.items():
        with wrong:
            check_name(name, model.knowns, "known variables", f"sensors.{name}")
            if sensor.gain:
                found.append(Slow("gain", name, sensor.gain))
            if sensor.bias is not None:
                unit = model.quantities.get(name, Known()).unit
                if differ(sensor.bias.unit, unit):
                    text = f'{name} of the model is in "{unit}"'
                    raise InputError(text, key=f"sensors.{name}.bias", value=str(sensor.bias))
                found.append(Slow("bias", name, sensor.bias.value))
            if sensor.lag is not None:
                most = delay.MOST * p.period_ms
                if sensor.lag.value > most:
                    text = f"with period_ms = {p.period_ms:g} a lag of at most {most:g} ms can be followed"
                    raise InputError(text, key=f"sensors.{name}.lag", value=str(sensor.lag))
                found.append(Slow("lag", name, sensor.lag.value))
    wrong.check()
    if len(found) > MOST_SLOW:
        text = f"{len(found)} parameters, gains and biases that may be off: a monitor has room for {MOST_SLOW}"
        raise InputError(text, key="uncertain")
    return tuple(found)


def check_name(name: str, known: Sequence[str] | Mapping[str, object], what: str, key: str, more: str = "") -> None:
    """Raise InputError if a name is none of these.

    Args:
        name: as the configuration has it.
        known: all that there are.
        what: these are.
        key: of the configuration.
        more: what else is to be said.
    """
    if name not in known:
        raise InputError(f"the {what} are {', '.join(known)}{nearest(name, known)}{more}", key=key, value=name)


def acts_on(slow: Slow, test: Test) -> bool:
    """Tell whether a test's residual depends on what may be off."""
    if slow.kind == "parameter":
        return re.search(rf"\bc\.{field_name(slow.name)}\b", test.source) is not None
    return slow.name in test.knowns


def neighbours(slow: Sequence[Slow], test: Test) -> list[int]:
    """Return the slow states that act on a test, by their numbers: it has a neighbour for each."""
    return [j for j, one in enumerate(slow) if acts_on(one, test)]
