"""Each step of a monitor, printed: its inputs, its state after it, and its results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gateway.bus.frames import Frames
from gateway.config.model import Config
from gateway.engine.core import Engine
from gateway.monitors.contract import FAILED, MAX_RESULTS, TIMER
from gateway_fdi.errors import InputError, nearest

#: Longest array of a state that is shown; histories are longer.
MOST_NUMBERS = 1000


def only(config: Config, name: str) -> Config:
    """Return a configuration with one of its monitors.

    Raises:
        InputError: there is none of that name.
    """
    kept = tuple(entry for entry in config.monitor if entry.name == name)
    if not kept:
        known = [entry.name for entry in config.monitor]
        text = f"the monitors are {', '.join(known)}{nearest(name, known)}"
        raise InputError(text, key="--only", value=name)
    gone = {entry.name for entry in config.monitor} - {name}
    settings = {fault: override for fault, override in config.fault.items() if fault.split(".")[0] not in gone}
    return config.model_copy(update={"monitor": kept, "fault": settings})


def single(frames: Frames) -> Iterator[Frames]:
    """Yield frames one by one."""
    for k in range(len(frames)):
        yield frames[k : k + 1]


class Trace:
    """Looks after each frame which monitors have stepped."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._steps = [int(h["steps"]) for h in engine.tables.handlers]

    def steps(self) -> Iterator[dict[str, Any]]:
        """Yield the last step of each monitor that has stepped since the last call, as events of the JSON contract."""
        for k, handler in enumerate(self._engine.tables.handlers):
            count = int(handler["steps"])
            if count != self._steps[k]:
                missed, self._steps[k] = count - self._steps[k] - 1, count
                yield self._step(k, count, missed)

    def _step(self, k: int, number: int, missed: int) -> dict[str, Any]:
        engine = self._engine
        instance, handler = engine.monitors[k], engine.tables.handlers[k]
        monitor = instance.monitor
        first = int(handler["inputs"])
        count = monitor.inputs.dtype.itemsize // 8
        cells = engine.tables.pool[first : first + count].copy()
        inputs = cells.view(monitor.inputs.dtype)[0]
        trigger = int(inputs["trigger"])
        out = engine.tables.out.view(monitor.results)[0] if len(engine.monitors) == 1 else None
        names = engine.plan.message_names
        told: dict[str, Any] = {
            "event": "step",
            "t_ns": engine.wall_ns(int(inputs["t_ns"])),
            "monitor": instance.name,
            "step": number,
            "not_shown": missed,
            "trigger": _trigger(trigger, names),
            "inputs": {name: _plain(inputs[name]) for name in (inputs.dtype.names or ())[2:]},
            "state": _plain(engine.state_of(k)[0]),
        }
        if out is not None:
            faults = monitor.faults(instance.params)
            told["results"] = [_result(out["results"][j], faults) for j in range(min(int(out["n"]), MAX_RESULTS))]
            if int(out["send"]) and monitor.outputs is not None:
                told["sent"] = _plain(out["values"])
            if int(out["wake_ns"]):
                told["wake_ns"] = engine.wall_ns(int(out["wake_ns"]))
        return told


def _trigger(index: int, names: Sequence[tuple[int, str]]) -> str:
    """Return what caused a step; the step may have written another number there."""
    if index == TIMER:
        return "timer"
    return names[index][1] if 0 <= index < len(names) else f"number {index}"


def _result(row: Any, faults: Any) -> dict[str, Any]:
    number, value, threshold = int(row["fault"]), float(row["value"]), float(row["threshold"])
    result = "failed" if int(row["result"]) == FAILED else "passed"
    if np.isnan(value) or np.isnan(threshold):
        result = "not tested"
    known = 0 <= number < len(faults)
    evidence = faults[number].evidence if known else ()
    return {
        "fault": faults[number].name if known else f"number {number}: there is none",
        "result": result,
        "value": value,
        "threshold": threshold,
        "evidence": dict(zip(evidence, row["cells"].tolist(), strict=False)),
    }


def _plain(value: Any) -> Any:
    """Return a record, an array or a number as JSON; values that are not numbers become None, a long array its size."""
    if value.dtype.names is not None and not value.shape:
        return {name: _plain(value[name]) for name in value.dtype.names}
    if value.size > MOST_NUMBERS:
        return f"{value.size} numbers"
    if value.shape:
        whole = value.dtype.names is None and (value.dtype.kind != "f" or np.isfinite(value).all())
        return value.tolist() if whole else [_plain(item) for item in value]
    number = value.item()
    return number if not isinstance(number, float) or np.isfinite(number) else None
