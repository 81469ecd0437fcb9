"""The monitor ``method``: its kernel hands each sample to Python, and reports what a method says of it.

This is the slow road: a step takes Python's lock and as long as the method does, where the gateway's own monitors are
compiled. It is for methods that are slow anyway, and periods of milliseconds and more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from gateway.monitors import contract
from gateway.monitors.contract import (
    Connection,
    Debounce,
    Family,
    Fault,
    Monitor,
    Notes,
    Out,
    Parts,
    Quantities,
    Quantity,
    Readout,
    Sampled,
    Signal,
    report,
)
from gateway.monitors.plain import calls
from gateway_arena.monitor import runner
from gateway_arena.monitor.fitted_file import Kept, load, read
from gateway_arena.monitor.params import MOST_FAULTS, MOST_INPUTS, Params, PartParams
from gateway_arena.score import NAMED
from gateway_fdi.errors import InputError, named
from gateway_fdi.jit import Record, call_entry, f8, f8s, i8, kernel, labels, means

TYPE, API = "method", 2
#: Name of what has no name: something is not as in the healthy log.
ABNORMAL = "abnormal"
#: Samples that a name has to stand, and that none may come before it is told that there is none.
NAME_AFTER, NO_NAME_AFTER = 5, 20


class State(Record):
    """Values that the kernel gives to Python, and gets from it."""

    value: Annotated[f8s, MOST_INPUTS] = means("the sample")
    gap: f8 = means("samples from the one before")
    at_ns: i8 = means("time of the sample", "ns")
    judged: i8 = means("whether the method says something of it")
    score: f8 = means("the larger, the more a fault is likely")
    which: i8 = means("the fault that it names, -1: none")
    weight: Annotated[f8s, MOST_FAULTS] = means("of each fault")
    samples: i8 = means("that the method took")
    left_out: i8 = means("samples in which a value was missing")
    begun: i8 = means("times that it began again after a gap")
    number: i8 = means("of the function that is called")


class Const(Record):
    """Constants."""

    call: i8 = means("address of Python's function")
    inputs: i8 = means("values of a sample")
    faults: i8 = means("faults that have a name")
    threshold: f8 = means("score above which it alarms")
    share: f8 = means("weight above which a fault is named")


class Inputs(contract.SampledInputs):
    """Inputs of a step."""

    value: Annotated[f8s, MOST_INPUTS] = means("the sample")


class Evidence(Record):
    """Values that are kept with a result."""

    score: f8 = means("score")
    threshold: f8 = means("score above which it alarms")
    weight: f8 = means("weight of the fault")


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Record]) -> None:
    """Have the method take a sample, and report what it says."""
    for k in range(c.inputs):
        s.value[k] = u.value[k]
    s.gap, s.at_ns = u.gap, u.t_ns
    if call_entry(c.call, s.number, 0, 0, 0) != 0:
        raise ValueError("the method failed")
    if s.judged == 0:
        return
    fired = s.score > c.threshold
    for k in range(c.faults):
        if fired and s.which < 0:
            break  # undecided: what has been named stays
        failed = fired and s.which == k
        weight = s.weight[k] if fired else s.score * 0.0  # NaN stays NaN: not tested
        e = report(out, k, failed, weight, c.share)
        e.score, e.threshold, e.weight = s.score, c.threshold, weight
    if not fired or s.which < 0:
        e = report(out, c.faults, fired, s.score, c.threshold)
        e.score, e.threshold, e.weight = s.score, c.threshold, 0.0


def _parts(
    p: Params, find: Callable[[str], Any], give: Callable[[Iterable[str]], Mapping[str, str]]
) -> dict[str, PartParams]:
    for k, name in enumerate(p.inputs):
        try:
            find(name)
        except InputError as error:
            raise InputError(error.message, key=f"inputs[{k}]", value=name) from error
    names = (*p.faults, ABNORMAL)
    for name in p.codes:
        if name not in names:
            raise InputError(named("the faults are", name, names), key=f"codes.{name}")
    own = {f"{Path(p.fitted).stem}.{name}": name for name in names if name not in p.codes}
    given = {own[name]: code for name, code in give(own).items()}
    return {"": PartParams(**p.model_dump(exclude_unset=True), given=p.codes | given)}


def _connect(p: Params) -> dict[str, Connection]:
    signals = [Signal(name, triggers=True, optional=True, may_be_nan=True) for name in p.inputs]
    return {"value": [*signals, *[None] * (MOST_INPUTS - len(signals))]}


def _faults(p: PartParams) -> tuple[Fault, ...]:
    evidence = labels(Evidence)
    found = [
        Fault(
            name, f"{p.given[name]}-00", f"{name}, by {p.method}", evidence, Debounce(NAME_AFTER, NAME_AFTER),
            tested="weight of the fault",
        )
        for name in p.faults
    ]  # fmt: skip
    text = f"not as in the healthy log, by {p.method}"
    debounce = Debounce(NO_NAME_AFTER if p.faults else NAME_AFTER, NAME_AFTER)
    return (*found, Fault(ABNORMAL, f"{p.given[ABNORMAL]}-00", text, evidence, debounce, tested="score"))


def _prepare(kept: Kept | None, path: Path, p: PartParams, s: Any, c: Any) -> None:
    stepper: runner.Stepper | None = runner.collector(p)
    if kept is not None:
        c.threshold = kept.threshold if p.threshold is None else p.threshold
        found = load(kept, path)
        if hasattr(found, "limit"):
            found.limit(float(c.threshold))
        stepper = runner.Runner(p, found, np.array(kept.low), np.array(kept.high))
    assert stepper is not None
    c.call, s.number = calls.address(), calls.enter(partial(stepper.step, s), s)
    c.inputs, c.faults, c.share = len(p.inputs), len(p.faults), NAMED
    s.which, s.score = -1, np.nan


def _made(p: Params, folder: Path) -> Monitor[Params]:
    wrong = [name for k, name in enumerate(p.faults) if name == ABNORMAL or name in p.faults[:k]]
    if wrong:
        raise InputError("each fault has a name of its own", key="faults", value=wrong[0])
    if runner.is_collecting():
        return _monitor_of(p.model_dump_json(), folder, None)
    kept = read(p, folder)
    return _monitor_of(p.model_dump_json(), folder, kept)


@lru_cache(maxsize=32)
def _monitor_of(_: str, folder: Path, kept: Kept | None) -> Monitor[Params]:
    def limit(p: Params) -> float:
        return p.threshold if p.threshold is not None else kept.threshold if kept is not None else np.nan

    return Monitor(
        type=TYPE,
        api=API,
        params=Params,
        state=State,
        const=Const,
        inputs=Inputs,
        evidence=Evidence,
        step=step,
        connect=_connect,
        prepare=lambda p, s, c: _prepare(kept, folder / p.fitted, p, s, c),  # type: ignore[arg-type] # of its part
        faults=_faults,  # type: ignore[arg-type]
        capabilities=(
            calls.FAILURE,
            Notes(lambda _: () if kept is None else (kept.told,)),
            Parts(_parts),
            Quantities(lambda p: (Quantity("score", limit=limit(p)),), lambda s: (float(s["score"]),)),
            Readout(("score", "samples", "left_out", "begun")),
            Sampled(lambda p: p.sampling),
        ),
    )


FAMILY = Family(type=TYPE, api=API, params=Params, made=_made)
