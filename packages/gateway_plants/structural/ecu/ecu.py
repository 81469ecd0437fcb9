"""The frames of a simulated model."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.common.extras import need
from gateway.signals.database import load_database
from gateway.signals.frame_encoding import sent
from gateway_bench.vecu.contract import Run, Truth, VirtualEcu
from gateway_fdi.common.resources import find
from gateway_fdi.errors import InputError, nearest, under
from gateway_fdi.structure.file import load_own_model
from gateway_fdi.structure.model import Model, Quantity
from gateway_fdi.structure.units import differ
from gateway_plants.structural.ecu.params import (
    Input,
    ModelMessage,
    Repeated,
    StructuralFault,
    StructuralParams,
    points_of,
)

if TYPE_CHECKING:
    from gateway_fdi.structure.simulation.plant import Course

Columns = dict[str, NDArray[np.float64]]


def _known(names: Iterable[str], known: Collection[str], what: str, key: str) -> None:
    for name in names:
        if name not in known:
            text = f"the model's {what} are {', '.join(known) or 'none'}{nearest(name, known)}"
            raise InputError(text, key=key, value=name)


def _checked(params: StructuralParams, model: Model, faults: Sequence[StructuralFault]) -> None:
    """Refuse names that the model does not have.

    Raises:
        InputError: the first of them.
    """
    everything = (*model.knowns, *model.full_variables)
    inputs = (*model.knowns, *(x for x in model.unknowns if x not in model.states))
    _known(params.inputs, inputs, "known variables, and unknowns without a derivative,", "inputs")
    _known(params.parameters, model.parameters, "parameters", "parameters")
    _known(params.start, model.states, "states", "start")
    _known(params.noise, everything, "variables", "noise")
    signals = [name for m in params.message for name in m.signals.values() if isinstance(name, str)]
    for k, message in enumerate(params.message):
        mine = [name for name in message.signals.values() if isinstance(name, str)]
        _known(mine, everything, "variables", f"message[{k}].signals")
    for fault in faults:
        if fault.kind == "freeze":
            _known([fault.name], signals, "variables that are sent", "fault.name")
        else:
            _known([fault.name], model.faults, "faults", "fault.name")


def _course(course: Input) -> Course:
    from gateway_fdi.structure.simulation.plant import Course  # noqa: PLC0415 - algebra and solver are slow to load

    points = points_of(course)
    repeat = course.repeat_s if isinstance(course, Repeated) else 0.0
    return Course(tuple(t for t, _ in points), tuple(v for _, v in points), repeat)


def _course_of(faults: Sequence[StructuralFault]) -> Course:
    """Return the course of one of the model's faults, from all that is scheduled of it.

    Raises:
        InputError: two of them at the same time.
    """
    from gateway_fdi.structure.simulation.plant import Course  # noqa: PLC0415

    points: list[tuple[float, float]] = [(0.0, 0.0)]
    for fault in sorted(faults, key=lambda one: one.from_s):
        if fault.from_s < points[-1][0] or (points[-1][1] != 0.0):
            raise InputError("the same fault twice at a time", key="fault.name", value=fault.name)
        points += [(fault.from_s, 0.0), (fault.from_s + fault.ramp_s, fault.size)]
        if fault.to_s is not None:
            end = max(fault.to_s, fault.from_s + fault.ramp_s)
            points += [(end, fault.size), (end, 0.0)]
    return Course(tuple(t for t, _ in points), tuple(v for _, v in points))


def _simulated(
    params: StructuralParams, model: Model, faults: Sequence[StructuralFault], times: NDArray[np.float64]
) -> Columns:
    """Return all variables at the times at which something is sent.

    Raises:
        InputError: the model cannot be simulated so.
    """
    from gateway_fdi.structure.simulation.plant import Plant  # noqa: PLC0415
    from gateway_fdi.structure.simulation.reduction import NotSimulatedError  # noqa: PLC0415

    own = [fault for fault in faults if fault.kind != "freeze"]
    courses = {name: _course_of([f for f in own if f.name == name]) for name in dict.fromkeys(f.name for f in own)}
    inputs = {name: _course(course) for name, course in params.inputs.items()}
    try:
        plant = Plant(model, inputs, parameters=params.parameters, start=params.start, rest=params.rest)
        return plant.run(times, courses, longest_s=params.longest_ms * 1e-3)
    except NotSimulatedError as error:
        raise InputError(str(error), key="model", value=params.model.name) from error


def _units(message: Message, signals: dict[str, str], model: Model) -> None:
    for signal in message.signals:
        name = signals.get(signal.name)
        told = model.quantities.get(name, Quantity()).unit if name is not None else ""
        if name is not None and differ(told, str(signal.unit or "")):
            text = f'{signal.name} is in "{signal.unit}", {name} of the model in "{told}"'
            raise InputError(text, key=f"signals.{signal.name}", value=name)


def _during(fault: StructuralFault, times: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which times lie in a fault's."""
    return (times >= fault.from_s) & (times < (np.inf if fault.to_s is None else fault.to_s))


def _columns(
    params: StructuralParams,
    message: ModelMessage,
    found: Columns,
    at: NDArray[np.int64],
    faults: Sequence[StructuralFault],
    run: Run,
) -> tuple[Columns, list[Truth]]:
    """Return the values of a message's signals as they are sent, and what was done to them."""
    columns, truth = {}, []
    times = found["t"][at]
    for signal, name in message.signals.items():
        if not isinstance(name, str):
            columns[signal] = np.full(len(at), name)
            continue
        values = found[name][at].copy()
        if name in params.noise:
            values += run.rng.normal(0.0, params.noise[name], len(at))
        for fault in faults:
            if fault.kind == "freeze" and fault.name == name:
                inside = np.flatnonzero(_during(fault, times))
                values[inside] = values[inside[:1]]
                truth.append(Truth(round(fault.from_s * 1e9), "freeze", len(inside)))
        columns[signal] = values
    return columns, truth


def _frames(params: StructuralParams, faults: Sequence[StructuralFault], run: Run) -> tuple[Frames, list[Truth]]:
    need("structure", "ECUs simulated from a structural model", key="type")
    model = load_own_model(params.model, key="model")
    _checked(params, model, faults)
    counts = [int(run.duration_s * 1e3 / m.period_ms) + 1 for m in params.message]
    each = [np.arange(n, dtype=np.float64) * m.period_ms * 1e-3 for n, m in zip(counts, params.message, strict=True)]
    times = np.unique(np.concatenate(each))
    found = _simulated(params, model, faults, times)
    found["t"] = times
    database = load_database(run.databases)
    truth = [
        Truth(round(fault.from_s * 1e9), fault.name, int(_during(fault, each[0]).sum()))
        for fault in faults
        if fault.kind != "freeze"
    ]
    made = []
    for k, (params_of, own) in enumerate(zip(params.message, each, strict=True)):
        with under(f"message[{k}]"):
            message = database.message(params_of.name)
            _units(message, {s: n for s, n in params_of.signals.items() if isinstance(n, str)}, model)
            columns, done = _columns(params, params_of, found, np.searchsorted(times, own), faults, run)
            made.append(sent(message, columns, own, params_of, bus=run.bus))
            truth += done
    frames = np.concatenate(made)
    return frames[np.argsort(frames["t_ns"], kind="stable")], truth


def _locate(params: StructuralParams, folder: Path, key: str) -> StructuralParams:
    """Return the parameters with the path of the model: beside the scenario, else among the shipped."""
    found = find(params.model, folder, "models", ".toml", beside="the scenario", key=f"{key}.model")
    return params.model_copy(update={"model": found})


ECU = VirtualEcu(
    type="structural", api=2, params=StructuralParams, fault=StructuralFault, frames=_frames, locate=_locate
)
