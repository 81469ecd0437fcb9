"""Bank of PI observers: each actuator and each sensor of a linear plant, with the size of its fault.

Source: Kim, Kim, Kawaji, "Fault Diagnosis of Actuators and Sensors with multiple PI observers" (paper 003), designed in
discrete time, with decisions of its own (:mod:`gateway_plants.linear.pi_bank.isolation`; of a plant that is not known
exactly :mod:`gateway_plants.linear.model_set`). One step a sample; samples that are lost are predicted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

from gateway.monitors.contract import (
    TIMER,
    VAGUE,
    Behind,
    Blame,
    Blames,
    Debounce,
    Fault,
    Monitor,
    Out,
    Readout,
    Refined,
    Refinement,
    Sampled,
    Warnings,
    report,
)
from gateway.monitors.evidence import words_of
from gateway_fdi.jit import Record, f8, f8s, i8, kernel, labels, means
from gateway_fdi.linear_algebra import copy
from gateway_plants.linear.model_set import alignment, decision
from gateway_plants.linear.monitor import plant as linear_plant
from gateway_plants.linear.monitor.pi_bank import window
from gateway_plants.linear.monitor.pi_bank.params import Params
from gateway_plants.linear.monitor.plant import AMBIGUOUS, COMMAND, FINDING, UNDECIDED
from gateway_plants.linear.monitor.refine import found, wanted
from gateway_plants.linear.pi_bank import bank, isolation
from gateway_plants.linear.pi_bank.isolation import NONE
from gateway_plants.linear.pi_bank.masking import masked


class Const(Record):
    """Constants."""

    sampling: linear_plant.Const = means("samples off the bus")
    isolation: isolation.Const = means("decisions on the bank")
    models: decision.Const = means("with model_error: the model set")
    logic: i8 = means("which of them decides")


class State(linear_plant.Watched):
    """State."""

    isolation: isolation.State = means("decisions on the bank")
    models: decision.State = means("with model_error: the model set")
    window: window.State = means("parity window of the last samples")
    active: i8 = means("observer or hypothesis in use")
    sensor: i8 = means("sensor at fault; NONE: none")
    nonlinear: i8 = means("1: with model_error: the plant's entries vary, it is not linear")


class Evidence(Record):
    """Evidence of each fault."""

    magnitude: f8 = means("size of the fault")
    observer: f8 = means("observer in use")
    innovation: Annotated[f8s, bank.MOST_OUTPUTS] = means("innovation")


#: Logics by their number.
JUMPS, MODELS = range(2)
_LOGICS = {"jumps": JUMPS, "models": MODELS}
#: What cannot be isolated comes first; then actuators, then sensors.
UNEXPLAINED = 0

#: Verdicts have been persistent already.
_FOUND = Debounce(failed_after=1, passed_after=5)
#: What the tests of actuators and sensors compare.
_SIZE = "size of the fault"


def _faults(p: Params) -> tuple[Fault, ...]:
    left = tuple(f"innovation of {words_of(name)}" for name in p.sensor_names)
    evidence = (*labels(Evidence)[:2], *left)
    found = [
        Fault(
            "unexplained",
            "C1B10-62",
            "sensors contradict each other; neither one sensor nor one actuator explains it",
            evidence,
            _FOUND,
        )
    ]
    for k, part in enumerate(p.input, start=1):
        text = f"actuator {words_of(part.name)}: does something else than it is commanded"
        found.append(Fault(f"actuator_{part.name}", part.dtc or f"C1B1{k}-64", text, evidence, _FOUND, tested=_SIZE))
    for k, sensor in enumerate(p.output, start=1):
        text = f"sensor {words_of(sensor.name)}: contradicts the others"
        found.append(Fault(f"sensor_{sensor.name}", sensor.dtc or f"C1B2{k}-64", text, evidence, _FOUND, tested=_SIZE))
    return tuple(found)


def _blames(p: Params) -> dict[str, list[Blame]]:
    """Return what each fault blames: its actuator or sensor; what is not isolated, each of them, and the model."""
    actuators = {part.name: Blame(part.signal, "actuator") for part in p.input}
    sensors = {part.name: Blame(part.signal) for part in p.output}
    every = [one._replace(share=VAGUE) for one in (*actuators.values(), *sensors.values())]
    # An actuator that does as it is told looks faulty, too, where the command that the bus carries is another one.
    found = {f"actuator_{part.name}": [actuators[part.name], Blame(part.signal, share=0.05)] for part in p.input}
    found |= {f"sensor_{name}": [one] for name, one in sensors.items()}
    return found | {"unexplained": [*every, Blame("model", "model")]}


#: How likely a window shows a fault that may be in it.
_SHOWS = 0.8


def _behind(p: Params) -> dict[str, list[Blame]]:
    """Return whom each test of a window blames: all parts but those that it leaves out."""
    parts = [*(Blame(part.signal, "actuator") for part in p.input), *(Blame(part.signal) for part in p.output)]
    model = Blame("model", "model")
    named = [*(part.name for part in p.input), *p.sensor_names]
    return {
        f"without {' and '.join(named[k] for k in apart) or 'none'}": [
            *(one._replace(share=_SHOWS) for k, one in enumerate(parts) if k not in apart),
            model,
        ]
        for apart in (p.windows.apart if p.windows is not None else ())
    }


def _levels(p: Params, s: Any) -> list[float]:
    return [] if p.windows is None else p.windows.levels(s["window"])


def _prepare(p: Params, s: State, c: Const) -> None:
    linear_plant.prepare(c.sampling, p)
    c.logic = _LOGICS[p.decided_by]
    s.sensor = NONE
    if c.logic == MODELS:
        times = {"mtfa_s": p.mtfa_s, "start_s": p.start_s, "hold_s": p.hold_s}
        task = decision.LEARNING if p.learning else decision.ISOLATING
        decision.prepare(s.models, c.models, p.told, patience_s=p.patience_s, task=task, **times)
        return
    alignment.prepare(c.models.filters.alignment, p.plant, p.lags, counted=p.counted)
    isolation.prepare(
        c.isolation,
        s.isolation,
        p.plant,
        p.noise,
        p.observers,
        actuator=p.actuator_limits,
        sensor=p.sensor_limits,
        mtfa_s=p.mtfa_s,
        start_s=p.start_s,
        hold_s=p.hold_s,
    )
    isolation.restart(s.isolation, c.isolation)


@kernel
def _report(
    s: State, c: Const, fault: int, failed: bool, value: float, limit: float, out: Out[Evidence, Record]
) -> None:
    """Report a test, with the size and what the observer or filter in use has left of the sensors as evidence."""
    e = report(out, fault, failed, abs(value), limit)
    if not failed:
        return
    e.magnitude = value
    if c.logic == MODELS:
        e.observer = float(s.models.active)
        left = s.models.filters.e[s.models.active]
    else:
        e.observer = float(s.isolation.active)
        left = s.isolation.bank.e[s.isolation.active]
    copy(e.innovation, left, bank.MOST_OUTPUTS)


@kernel
def _conclude(s: State, c: Const, out: Out[Evidence, Record]) -> None:
    """Report what the isolation has found."""
    x, o = s.isolation, c.isolation.bank
    if x.unexplained == 1:
        _report(s, c, UNEXPLAINED, True, 1.0, 0.0, out)
        return
    if x.tested == 0:
        return
    _report(s, c, UNEXPLAINED, False, 0.0, 0.0, out)
    for i in range(o.m):
        _report(s, c, 1 + i, x.actuator[i] == 1, x.fault[i], x.limit[i], out)
    for j in range(o.p):
        failed = x.latched == j and x.suspect.confirmed == 1
        _report(s, c, 1 + o.m + j, failed, x.offset[j], c.isolation.sensor[j], out)


@kernel
def _models(s: State, c: Const, out: Out[Evidence, Record]) -> None:
    """Take one sample by hypotheses."""
    x, f = s.models, c.models.filters
    if not decision.step(x, c.models, s.y, s.sampling.u, s.sampling.unsure):
        return
    s.sensor, s.nonlinear = NONE, x.filters.varies
    if c.models.task == decision.LEARNING:
        s.reason = FINDING
        return
    if x.unexplained == 1:
        s.reason = AMBIGUOUS
        _report(s, c, UNEXPLAINED, True, 1.0, 0.0, out)
        return
    if x.tested == 0:
        s.reason = FINDING if x.done < c.models.start else UNDECIDED
        return
    _report(s, c, UNEXPLAINED, False, 0.0, 0.0, out)
    named = decision.part_of(c.models, x.active)
    for part in range(f.m + f.p):
        limit = c.models.actuator[part] if part < f.m else c.models.sensor[part - f.m]
        at_fault = part == named and x.suspect.confirmed == 1
        _report(s, c, 1 + part, at_fault, x.magnitude if at_fault else 0.0, limit, out)
    if named >= f.m:
        s.sensor = named - f.m


@kernel
def _one(s: State, c: Const, u: linear_plant.Inputs, at: int, came: bool, out: Out[Evidence, Record]) -> None:
    """Take one sample, ``at`` samples behind the one before; its outputs came, or it is predicted."""
    linear_plant.take(s, c.sampling, u, at, came)
    x, a = s.isolation, s.models.filters.aligned
    if c.logic == MODELS:
        _models(s, c, out)
        s.active = s.models.active
        return
    there = alignment.align(a, c.models.filters.alignment, s.y, s.sampling.u, s.sampling.unsure)
    if there:
        isolation.step(x, c.isolation, a.y, a.u)
    else:
        isolation.missing(x, c.isolation, a.u)
    lost = False
    for i in range(c.isolation.bank.m):
        lost = lost or a.unsure[i] == 1
    if there:
        window.keep(s.window, a.y, a.u, not lost)
    else:
        s.window.held = 0
    if lost:
        isolation.unknown_command(x, c.isolation)
    s.active, s.sensor = x.active, x.latched
    if not there:
        return
    if x.unexplained == 1:
        s.reason = AMBIGUOUS
    elif x.tested == 0:
        s.reason = FINDING if x.started == 0 else (COMMAND if x.blind > 0 else UNDECIDED)
    _conclude(s, c, out)


@kernel
def step(s: State, c: Const, u: linear_plant.Inputs, out: Out[Evidence, Record]) -> None:
    """Take one sample."""
    if u.trigger == TIMER:
        return
    if linear_plant.command(s.sampling, c.sampling, u):
        linear_plant.late(s.sampling, c.sampling, s.models.filters.aligned, c.models.filters.alignment)
        return
    steps = linear_plant.samples(s.sampling, c.sampling, u)
    if steps == 0:
        return
    if linear_plant.begin_anew(s, steps):
        s.models.filters.aligned.begun = s.window.held = 0
        if c.logic == MODELS:
            decision.restart(s.models, c.models)
        else:
            isolation.restart(s.isolation, c.isolation)
    else:
        for k in range(steps - 1):  # each with the command that held then
            _one(s, c, u, k + 1, False, out)
    _one(s, c, u, steps, True, out)
    linear_plant.taken(s)


def _warnings(p: Params) -> tuple[str, ...]:
    """Say which faults hide each other from stationary values."""
    said = []
    if p.decided_by == "models":
        for j, part in enumerate(p.output):
            if j not in p.told.left_out:
                said.append(
                    f"sensor {part.name} cannot be left out: without it the others do not show the whole plant. "
                    "Its faults are told by their course only, and may stay unexplained"
                )
        return tuple(said)
    sizes = 5.0 * p.actuator_limits
    for hidden in masked(p.plant, sizes, p.actuator_limits):
        actuator, sensor = p.input[hidden.actuator], p.output[hidden.sensor]
        if max(abs(hidden.low), abs(hidden.high)) < sensor.limit:
            continue  # such a small fault of the sensor counts as none
        said.append(
            f"actuator {actuator.name} off by {sizes[hidden.actuator]:.3g} is hidden in the observer without "
            f"{p.output[hidden.observer].name} by a slowly growing error of sensor {sensor.name} of "
            f"{hidden.low:.3g} to {hidden.high:.3g}"
        )
    return tuple(said)


def _wanted(p: Params) -> Mapping[str, Any]:
    """Return the keys with which healthy logs are replayed."""
    return {**wanted(p), "logic": "models"}


def _found(p: Params, s: Any) -> Refined:
    """Return what a log says; a model that is known to some percent is decided by models."""
    refined = found(p, s)
    return replace(refined, keys={**refined.keys, "logic": None})


MONITOR = Monitor(
    type="pi_bank",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=linear_plant.Inputs,
    evidence=Evidence,
    step=step,
    connect=linear_plant.connect,
    triggers=linear_plant.triggers,
    prepare=_prepare,
    faults=_faults,
    capabilities=(
        Behind(_behind, _levels),
        Blames(_blames),
        Readout(("active", "sensor", "missing", "restarts", "commands_lost", "untested", "reason", "nonlinear")),
        Refinement(_wanted, _found),
        Sampled(linear_plant.samplings),
        Warnings(_warnings),
    ),
)
