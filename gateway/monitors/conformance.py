"""Does a monitor keep the contract? All of it is checked once, when the engine is built.

Compiled code checks nothing: a wired signal too many would be written beyond its array, a fault's number too large
would be another monitor's fault. Each error here names the monitor, the field and the file.
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple, cast

import numpy as np

from gateway.monitors.authors import author_of
from gateway.monitors.contract import (
    API,
    EVIDENCE,
    MAX_OUTPUTS,
    Calibration,
    Capability,
    CusumCalibration,
    Debounce,
    Emission,
    Family,
    Fault,
    Inputs,
    Monitor,
    MonitorParams,
    Numbered,
    Readout,
    Sampled,
    SampledInputs,
    Signal,
)
from gateway.monitors.sampling import Sampling
from gateway_fdi.errors import InputError, nearest
from gateway_fdi.jit import Record

#: Longest time of a debounce, as a configuration may have it, too [ms].
MOST_DEBOUNCE_MS = 3.6e6
#: Largest counter of one, and step of it, likewise.
MOST_DEBOUNCE = 32767

_FLOAT = np.dtype("<f8")
#: Fields of the inputs that the engine fills itself.
_OWN = tuple(SampledInputs.dtype.names or ())


def accepted(monitor: object, name: str) -> Monitor[Any] | Family[Any]:
    """Return what a name stands for, if it is a monitor that keeps the contract as far as its type can tell.

    Of a family that is little; the rest is checked of each monitor that it makes (:func:`made`).

    Raises:
        InputError: it is none, one of another version, or something of it is wrong.
    """
    if not isinstance(monitor, Monitor | Family):
        raise InputError(f"this is no Monitor, but {type(monitor).__name__}", value=name)
    if isinstance(monitor, Monitor) and not isinstance(getattr(monitor.step, "py_func", monitor.step), FunctionType):
        raise InputError(f"its step is no kernel, but {type(monitor.step).__name__}", value=name)
    if monitor.api != API:
        raise InputError(
            f"written for version {monitor.api!r} of the contract, this gateway has {API}",
            file=monitor.file,
            key=f'monitor type "{monitor.type}".api',
            value=monitor.api,
        )
    if isinstance(monitor, Family):
        _check_params(monitor)
    else:
        check_type(monitor)
    return monitor


def made(family: Family[Any], params: MonitorParams, folder: Path) -> Monitor[Any]:
    """Return the monitor that a family makes of parameters, if it keeps the contract.

    Raises:
        InputError, InputErrors: nothing can be made of them, or what is made is not as the contract has it.
    """
    monitor = family.made(params, folder)
    key = f'monitor type "{family.type}".made'
    if not isinstance(monitor, Monitor):
        raise InputError(f"this is no Monitor, but {type(monitor).__name__}", file=family.file, key=key)
    if (monitor.type, monitor.api, monitor.params) != (family.type, family.api, family.params):
        text = "a monitor of a family has its type, api and params"
        raise InputError(text, file=family.file, key=key, value=monitor.type)
    check_type(monitor)
    return monitor


def _check_params(family: Family[Any]) -> None:
    if not (isinstance(family.params, type) and issubclass(family.params, MonitorParams)):
        raise InputError(
            "a class that derives from MonitorParams", file=family.file, key=f'monitor type "{family.type}".params'
        )


def check_type(monitor: Monitor[Any]) -> None:
    """Check what does not depend on parameters.

    Raises:
        InputError: the first thing that is not as the contract has it.
    """
    for message, key in _wrong_in_type(monitor):
        raise InputError(message, file=monitor.file, key=f'monitor type "{monitor.type}".{key}')


def _wrong_in_type(monitor: Monitor[Any]) -> Iterator[tuple[str, str]]:
    if not (isinstance(monitor.params, type) and issubclass(monitor.params, MonitorParams)):
        yield "a class that derives from MonitorParams", "params"
    for name, base in (("state", Record), ("const", Record), ("inputs", Inputs)):
        kind = getattr(monitor, name)
        if not (isinstance(kind, type) and issubclass(kind, base)):
            yield f"a class that derives from {base.__name__}", name
            return
    for name, most in (("evidence", EVIDENCE), ("outputs", MAX_OUTPUTS)):
        kind = getattr(monitor, name)
        if kind is None:
            continue
        if not (isinstance(kind, type) and issubclass(kind, Record)):
            yield "a class that derives from Record", name
            return
        if kind.dtype.itemsize > 8 * most:
            yield f"{kind.dtype.itemsize // 8} numbers; there is room for {most}", name
        yield from ((text, f"{name}.{field}") for field, text in _no_numbers(kind.dtype))
    wired = {"inputs": monitor.inputs.dtype}
    if monitor.outputs is not None:
        wired["outputs"] = monitor.outputs.dtype
    for name, dtype in wired.items():  # a signal each
        own = _OWN if issubclass(monitor.inputs, SampledInputs) else Inputs.dtype.names or ()
        for field in set(dtype.names or ()).difference(own):
            if dtype[field].base != _FLOAT:
                yield "a field here is float64: f8, or an array of f8s", f"{name}.{field}"
    function = getattr(monitor.step, "py_func", monitor.step)
    if len(inspect.signature(function).parameters) != 4:
        yield "step takes (s, c, u, out): state, constants, inputs, results", "step"
    yield from _wrong_capabilities(monitor)


def _no_numbers(dtype: np.dtype[np.void]) -> Iterator[tuple[str, str]]:
    """Yield fields that are neither float64 nor arrays nor records of float64."""
    for name in dtype.names or ():
        base = dtype[name].base
        if base.names is not None:
            yield from ((f"{name}.{field}", text) for field, text in _no_numbers(base))
        elif base != _FLOAT:
            yield name, "a field here is float64: f8, or an array of f8s"


def _wrong_capabilities(monitor: Monitor[Any]) -> Iterator[tuple[str, str]]:
    given: object = monitor.capabilities
    if not isinstance(given, tuple | list) or not all(isinstance(found, Capability) for found in given):
        yield 'a tuple of what it can do beside: (Readout(("lowest",)),)', "capabilities"
        return
    kinds = Counter(type(found).__name__ for found in monitor.capabilities)
    for kind, count in kinds.items():
        if count > 1:
            yield f"{kind} is there {count} times", "capabilities"
    if monitor.capability(Calibration) and monitor.capability(CusumCalibration):
        yield "one kind of calibration", "capabilities"
    known = monitor.state.dtype.names or ()
    for name in monitor.readout:
        if name not in known:
            yield f"the state has no field {name!r}{nearest(name, known)}", "capabilities"
        elif monitor.state.dtype[name].shape or monitor.state.dtype[name].names is not None:
            yield f"the state's field {name!r} is not one number", "capabilities"
    numbered = monitor.capability(Numbered)
    if numbered is not None and (numbered.field not in (monitor.const.dtype.names or ()) or monitor.triggers is None):
        yield f"the constants have no field {numbered.field!r}, or the monitor has no triggers", "capabilities"
    if (monitor.capability(Sampled) is None) == issubclass(monitor.inputs, SampledInputs):
        yield "the capability Sampled and inputs that derive from SampledInputs go together", "inputs"
    if monitor.capability(Readout) is not None and len(set(monitor.readout)) < len(monitor.readout):
        yield "a field is shown twice", "capabilities"


def checked_faults(monitor: Monitor[Any], params: MonitorParams) -> tuple[Fault, ...]:
    """Return what a monitor with these parameters can report.

    Raises:
        InputError: a name that is there twice, more evidence than a result has room for, a debounce that nothing ends.
    """
    with author_of(monitor, "faults"):
        given = monitor.faults(params)
        faults = tuple(given) if isinstance(given, Iterable) else (given,)
    for k, fault in enumerate(faults):
        _check_fault(monitor, fault, f'monitor type "{monitor.type}".faults[{k}]')
    most = monitor.evidence.dtype.itemsize // 8
    names = [fault.name for fault in faults]
    for k, fault in enumerate(faults):
        key = f'monitor type "{monitor.type}".faults[{k}]'
        if fault.name in names[:k]:
            raise InputError("this name is taken", file=monitor.file, key=f"{key}.name", value=fault.name)
        if len(fault.evidence) > most:
            raise InputError(
                f"{len(fault.evidence)} names of evidence; a result has room for {most}",
                file=monitor.file,
                key=f"{key}.evidence",
                value=fault.name,
            )
        _check_debounce(monitor, fault, key)
    return faults


def _check_fault(monitor: Monitor[Any], fault: object, key: str) -> None:
    """Refuse what is no fault, or one with a field of another kind."""
    if not isinstance(fault, Fault):
        text = f"this is no Fault, but {type(fault).__name__}"
        raise InputError(text, file=monitor.file, key=key)
    for name in ("name", "dtc", "description", "remedy", "tested"):
        if not isinstance(getattr(fault, name), str):
            raise InputError("a text", file=monitor.file, key=f"{key}.{name}", value=getattr(fault, name))
    if not fault.name or not fault.name.isprintable():
        raise InputError("a name of letters and digits", file=monitor.file, key=f"{key}.name", value=fault.name)
    names: object = fault.evidence
    if not isinstance(names, tuple | list) or not all(isinstance(name, str) for name in names):
        raise InputError("names, a tuple of texts", file=monitor.file, key=f"{key}.evidence", value=fault.evidence)
    if not isinstance(fault.debounce, Debounce):
        raise InputError("a Debounce", file=monitor.file, key=f"{key}.debounce", value=fault.debounce)


def _check_debounce(monitor: Monitor[Any], fault: Fault, key: str) -> None:
    """Refuse a debounce by which a fault would never be set, or never be healed: without a word."""
    asked = fault.debounce
    for name in ("failed_after", "passed_after", "failed_step", "passed_step", "jump_up_to", "jump_down_to"):
        if not isinstance(getattr(asked, name), int | np.integer):
            text = f"{name} = {getattr(asked, name)!r}: a whole number"
            raise InputError(text, file=monitor.file, key=f"{key}.debounce", value=fault.name)
    for name in ("failed_after", "passed_after", "failed_step", "passed_step"):
        if not 1 <= getattr(asked, name) <= MOST_DEBOUNCE:
            text = f"{name} = {getattr(asked, name)!r}: at least 1, at most {MOST_DEBOUNCE}"
            raise InputError(text, file=monitor.file, key=f"{key}.debounce", value=fault.name)
    times = (asked.failed_ms, asked.passed_ms)
    if (times[0] is None) != (times[1] is None):
        text = "a debounce by time needs both failed_ms and passed_ms"
        raise InputError(text, file=monitor.file, key=f"{key}.debounce", value=fault.name)
    for name, time_ms in zip(("failed_ms", "passed_ms"), times, strict=True):
        known = isinstance(time_ms, int | float | np.number) and 0.0 <= time_ms <= MOST_DEBOUNCE_MS
        if time_ms is not None and not known:
            text = f"{name} = {time_ms!r}: 0 to {MOST_DEBOUNCE_MS:g} ms"
            raise InputError(text, file=monitor.file, key=f"{key}.debounce", value=fault.name)


def _fields(monitor: Monitor[Any]) -> list[tuple[str, int, bool]]:
    """Return the inputs that are connected: name, how many numbers, whether it is an array."""
    dtype = monitor.inputs.dtype
    return [
        (name, int(np.prod(dtype[name].shape)), bool(dtype[name].shape))
        for name in dtype.names or ()
        if dtype.fields is not None and dtype.fields[name][1] >= 8 * monitor.header
    ]


class Connected(NamedTuple):
    """Connections of the inputs of a monitor.

    Attributes:
        inputs: name and signal of each number of the inputs, in their order.
        signals: names of the signals whose messages step it.
        messages: further messages that do.
    """

    inputs: list[tuple[str, Signal | None]]
    signals: set[str]
    messages: set[str]


def connections(monitor: Monitor[Any], params: MonitorParams) -> Connected:
    """Return what each number of the inputs is connected to.

    Raises:
        InputError: an input that is not named, or that is not there; an array of another length; nothing that triggers.
    """
    with author_of(monitor, "connect"):
        given: object = monitor.connect(params)
    key = f'monitor type "{monitor.type}".connect'
    if not isinstance(given, Mapping):
        text = f"inputs and their connections, not {type(given).__name__}"
        raise InputError(text, file=monitor.file, key=key)
    fields = _fields(monitor)
    known = [name for name, *_ in fields]
    for name in given:
        if name not in known:
            raise InputError(
                f"there is no such input{nearest(name, known)}; the inputs are {', '.join(known)}",
                file=monitor.file, key=key, value=name,
            )  # fmt: skip
    found: list[tuple[str, Signal | None]] = []
    for name, count, is_array in fields:
        if name not in given:
            raise InputError(
                "this input is not connected; None, if nothing is connected to it",
                file=monitor.file, key=f"{key}.{name}",
            )  # fmt: skip
        found += _of_field(monitor, name, given[name], count, is_array)
    triggers = {signal.name for _, signal in found if signal is not None and signal.triggers}
    with author_of(monitor, "triggers"):
        named: object = () if monitor.triggers is None else monitor.triggers(params)
    if not isinstance(named, tuple | list | set) or not all(isinstance(message, str) for message in named):
        text = f"names of messages, a tuple of texts, not {type(named).__name__}"
        raise InputError(text, file=monitor.file, key=f'monitor type "{monitor.type}".triggers')
    messages = set(named)
    if not triggers and not messages:
        raise InputError("no signal triggers: nothing would step it", file=monitor.file, key=key)
    return Connected(found, triggers, messages)


def _of_field(
    monitor: Monitor[Any], name: str, given: Any, count: int, is_array: bool
) -> Iterable[tuple[str, Signal | None]]:
    key = f'monitor type "{monitor.type}".connect.{name}'
    if given is None:
        return [(name, None)] * count
    parts = given if isinstance(given, list | tuple) else [given]
    for part in parts:
        if part is not None and not (isinstance(part, Signal) and isinstance(cast("object", part.name), str)):
            text = 'a Signal("Message.Signal"), or None'
            raise InputError(text, file=monitor.file, key=key, value=part)
    if isinstance(given, Signal) and not is_array:
        return [(name, given)]
    if isinstance(given, Signal):
        raise InputError(f"an array of {count}: one signal for each", file=monitor.file, key=key)
    if not is_array:
        raise InputError(f"one signal, not {len(given)}", file=monitor.file, key=key)
    if len(given) != count:
        raise InputError(f"{len(given)} signals for an array of {count}", file=monitor.file, key=key)
    return [(f"{name}[{k}]", signal) for k, signal in enumerate(given)]


def samplings_of(monitor: Monitor[Any], params: MonitorParams) -> tuple[Sampling, ...]:
    """Return how the frames of a monitor become samples; none: each steps it.

    Raises:
        InputError: its answer is no Sampling, or names no input.
    """
    sampled = monitor.capability(Sampled)
    if sampled is None:
        return ()
    given: object = sampled.of(params)
    found = given if isinstance(given, tuple | list) and given else (given,)
    key = f'monitor type "{monitor.type}".Sampled.of'
    for one in found:
        if not isinstance(one, Sampling):
            raise InputError(f"a Sampling, not {type(one).__name__}", file=monitor.file, key=key)
        known = [name for name in monitor.inputs.dtype.names or () if name not in _OWN]
        for name in set(one.inputs) - set(known):
            raise InputError(f"there is no such input{nearest(name, known)}", file=monitor.file, key=key, value=name)
        if len(found) > 1 and not one.inputs:
            raise InputError("of several samplings each says its inputs", file=monitor.file, key=key)
    return tuple(found)


def checked_emission(monitor: Monitor[Any], params: MonitorParams) -> Emission | None:
    """Return the message that a monitor can send.

    Raises:
        InputError: outputs without a signal, or signals without an output.
    """
    if monitor.emits is None or monitor.outputs is None:
        if monitor.emits is not None or monitor.outputs is not None:
            raise InputError(
                "outputs and emits go together",
                file=monitor.file,
                key=f'monitor type "{monitor.type}".emits',
            )
        return None
    with author_of(monitor, "emits"):
        emission = monitor.emits(params)
    dtype = monitor.outputs.dtype
    key = f'monitor type "{monitor.type}".emits'
    if not isinstance(emission, Emission):
        raise InputError(f"this is no Emission, but {type(emission).__name__}", file=monitor.file, key=key)
    signals: object = emission.signals
    if not isinstance(signals, Mapping):
        text = f"fields of the outputs and their signals, not {type(signals).__name__}"
        raise InputError(text, file=monitor.file, key=key)
    fields: Mapping[str, tuple[int, ...]] = {name: dtype[name].shape for name in dtype.names or ()}
    if list(emission.signals) != list(fields):
        raise InputError(
            f"signals for each output, in their order: {', '.join(fields)}",
            file=monitor.file, key=key, value=", ".join(emission.signals),
        )  # fmt: skip
    for name, shape in fields.items():
        names = emission.signals[name]
        count = 1 if isinstance(names, str) else len(names)
        if bool(shape) == isinstance(names, str) or count != int(np.prod(shape)):
            raise InputError(
                f"{count} signals for {int(np.prod(shape))} numbers",
                file=monitor.file,
                key=f"{key}.{name}",
            )
    return emission
