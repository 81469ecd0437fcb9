"""Bank of PI observers: each actuator and each sensor of a linear plant, with the size of its fault.

Source: Kim, Kim, Kawaji, "Fault Diagnosis of Actuators and Sensors with multiple PI observers" (paper 003), in discrete
time, with a decision of its own (:mod:`gateway_plants.linear.model_set`), of plants that are known exactly and of
others. One step a sample; samples that are lost are predicted.
"""

from __future__ import annotations

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
    Refinement,
    Sampled,
    Warnings,
    report,
)
from gateway.monitors.evidence import words_of
from gateway_fdi.jit import Record, f8, f8s, i8, kernel, labels, means
from gateway_fdi.linear_algebra import copy
from gateway_plants.linear.mathematics.plant import MOST_OUTPUTS
from gateway_plants.linear.model_set import decision, isolation, records
from gateway_plants.linear.model_set.records import NONE
from gateway_plants.linear.monitor import plant as linear_plant
from gateway_plants.linear.monitor.pi_bank import window
from gateway_plants.linear.monitor.pi_bank.params import Params
from gateway_plants.linear.monitor.plant import AMBIGUOUS, FINDING, UNDECIDED
from gateway_plants.linear.monitor.refine import found, wanted
from gateway_plants.linear.pi_bank.masking import masked


class Const(Record):
    """Constants."""

    sampling: linear_plant.Const = means("samples off the bus")
    models: records.Const = means("the model set")
    windows: i8 = means("1: windows are kept")


class State(linear_plant.Watched):
    """State."""

    models: records.State = means("the model set")
    window: window.State = means("parity window of the last samples")
    sensor: i8 = means("sensor at fault; NONE: none")
    nonlinear: i8 = means("1: with model_error: the plant's entries vary, it is not linear")


class Evidence(Record):
    """Evidence of each fault."""

    magnitude: f8 = means("size of the fault")
    innovation: Annotated[f8s, MOST_OUTPUTS] = means("innovation")


#: What cannot be isolated comes first; then actuators, then sensors.
UNEXPLAINED = 0

#: Verdicts have been persistent already.
_FOUND = Debounce(failed_after=1, passed_after=5)
#: What the tests of actuators and sensors compare.
_SIZE = "size of the fault"


def _faults(p: Params) -> tuple[Fault, ...]:
    left = tuple(f"innovation of {words_of(name)}" for name in p.sensor_names)
    evidence = (*labels(Evidence)[:1], *left)
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
    c.windows = p.windows is not None
    s.sensor = NONE
    times = {"mtfa_s": p.mtfa_s, "start_s": p.start_s, "hold_s": p.hold_s}
    task = records.LEARNING if p.learning else records.ISOLATING
    decision.prepare(s.models, c.models, p.told, patience_s=p.patience_s, task=task, **times)


@kernel
def _report(s: State, fault: int, failed: bool, value: float, limit: float, out: Out[Evidence, Record]) -> None:
    """Report a test, with the size and what the filter in use has left of the sensors as evidence."""
    e = report(out, fault, failed, abs(value), limit)
    if not failed:
        return
    e.magnitude = value
    copy(e.innovation, s.models.filters.e[0], MOST_OUTPUTS)


@kernel
def _conclude(s: State, c: Const, out: Out[Evidence, Record]) -> None:
    """Report what a sample says of each part."""
    x, f = s.models, c.models.filters
    s.sensor, s.nonlinear = NONE, x.filters.varies
    if c.models.task == records.LEARNING:
        s.reason = FINDING
        return
    if x.unexplained == 1:
        s.reason = AMBIGUOUS
        _report(s, UNEXPLAINED, True, 1.0, 0.0, out)
        return
    if x.tested == 0:
        s.reason = FINDING if x.done < c.models.start else UNDECIDED
        return
    _report(s, UNEXPLAINED, False, 0.0, 0.0, out)
    for part in range(f.m + f.p):
        limit = c.models.actuator[part] if part < f.m else c.models.sensor[part - f.m]
        at_fault = isolation.at_fault(x, part)
        _report(s, 1 + part, at_fault, x.magnitude[part] if at_fault else 0.0, limit, out)
        if at_fault and part >= f.m:
            s.sensor = part - f.m


@kernel
def _one(s: State, c: Const, u: linear_plant.Inputs, at: int, came: bool, out: Out[Evidence, Record]) -> None:
    """Take one sample, ``at`` samples behind the one before; its outputs came, or it is predicted."""
    linear_plant.take(s, c.sampling, u, at, came)
    a = s.models.filters.aligned
    there = decision.step(s.models, c.models, s.y, s.sampling.u, s.sampling.unsure)
    if c.windows == 1 and there:
        sure = True
        for i in range(c.models.filters.m):
            sure = sure and a.unsure[i] == 0
        window.keep(s.window, a.y, a.u, sure)
    elif c.windows == 1:
        s.window.held = 0
    if there:
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
        isolation.restart(s.models, c.models)
    else:
        for k in range(steps - 1):  # each with the command that held then
            _one(s, c, u, k + 1, False, out)
    _one(s, c, u, steps, True, out)
    linear_plant.taken(s)


def _warnings(p: Params) -> tuple[str, ...]:
    """Say which faults hide each other from stationary values."""
    if not p.exact:
        return tuple(
            f"sensor {part.name} cannot be left out: without it the others do not show the whole plant. "
            "Its faults are told by their course only, and may stay unexplained"
            for j, part in enumerate(p.output)
            if j not in p.told.left_out
        )
    said = []
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
        Readout(("sensor", "missing", "restarts", "commands_lost", "untested", "reason", "nonlinear")),
        Refinement(wanted, found),
        Sampled(linear_plant.samplings),
        Warnings(_warnings),
    ),
)
