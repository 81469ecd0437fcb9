"""Any linear plant by configuration: one observer, and what it leaves of each sensor.

    e(k) = y(k) - C x(k),   x(k+1) = Phi x(k) + Gamma u(k) + L(k) e(k)

Each innovation, in its own standard deviations, goes through a stopping rule (:mod:`gateway_fdi.stopping`), and so does
the normalised innovation squared e^T V^-1 e of all of them. It detects; it does not isolate: a fault of one sensor
moves the observer, and shows in the others (paper 003, section 4.1). For that there is ``pi_bank``.

The observer is the healthy hypothesis of the bank (:mod:`gateway_plants.linear.model_set`), a Kalman filter with what
is not exact as slow states: with ``model_error`` the errors of the matrices, and what a sensor's ``accuracy`` says;
without them nothing, and L goes to the stationary filter's gain. The covariance of its innovations, V, grows with what
the plant does, with samples and commands that are lost, and shrinks as the errors are learned.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gateway.monitors.contract import (
    TIMER,
    Blame,
    Blames,
    Debounce,
    Fault,
    Monitor,
    Out,
    Readout,
    Refinement,
    Sampled,
    report,
)
from gateway.monitors.evidence import words_of
from gateway_fdi import run_length, stopping
from gateway_fdi.jit import Record, f8, kernel, labels, means
from gateway_fdi.quantiles import chi2_above
from gateway_plants.linear.mathematics.plant import MOST_OUTPUTS
from gateway_plants.linear.model_set import decision, isolation, records
from gateway_plants.linear.monitor import plant as linear_plant
from gateway_plants.linear.monitor.plant import FINDING, Inputs
from gateway_plants.linear.monitor.refine import found, wanted
from gateway_plants.linear.monitor.uncertain import UncertainPlantParams


class Const(Record):
    """Constants."""

    sampling: linear_plant.Const = means("samples off the bus")
    models: records.Const = means("the healthy hypothesis")
    rule: stopping.Const = means("stopping rule of each innovation")
    total: f8 = means("threshold of e^T V^-1 e")


class State(linear_plant.Watched):
    """State."""

    models: records.State = means("the healthy hypothesis")
    rules: Annotated[list[stopping.State], MOST_OUTPUTS] = means("stopping rule of each innovation")
    nis: f8 = means("normalised innovation squared")


class Evidence(Record):
    """Evidence of each fault."""

    innovation: f8 = means("innovation")
    nis: f8 = means("normalised innovation squared")


#: Innovation of the whole; then of each sensor.
WHOLE = 0
#: Change of the mean that the CUSUM looks for, in standard deviations.
SHIFT = 1.0


class Params(UncertainPlantParams):
    """A linear plant, watched by one observer."""

    rule: Literal["direct", "cusum"] = Field("direct", description="what makes an alarm of an innovation")
    level: float | None = Field(
        None,
        gt=0,
        description="of the rule, in standard deviations of the innovation; default: from mtfa_s",
    )
    start_s: float = Field(5.0, ge=0, description="at the start nothing is judged for so long [s]")

    @model_validator(mode="after")
    def _observable(self) -> Self:
        self.check_filters()
        return self

    @property
    def usual_offset(self) -> float:
        """As of its base; a plant that is what its matrices say has none."""
        return 0.0 if self.model_error is None else super().usual_offset

    @property
    def threshold(self) -> float:
        """Level of the rule, in standard deviations."""
        if self.level is not None:
            return self.level
        samples = self.mtfa_s / (self.sample_ms * 1e-3) * len(self.output)
        return run_length.direct(samples) if self.rule == "direct" else run_length.cusum(samples, 0.5 * SHIFT)


def _faults(p: Params) -> tuple[Fault, ...]:
    debounce = Debounce(failed_after=3, passed_after=50)
    found = [
        Fault(
            "innovation",
            "C1B30-64",
            "the plant does not do what its model does",
            labels(Evidence),
            debounce,
            tested="normalised innovation squared",
        )
    ]
    for k, part in enumerate(p.output, start=1):
        text = f"{words_of(part.name)} is not what the observer expects"
        found.append(
            Fault(
                f"innovation_{part.name}",
                part.dtc or f"C1B3{k}-64",
                text,
                labels(Evidence),
                debounce,
                tested="level of its alarm, from the innovations",
            )
        )
    return tuple(found)


def _blames(p: Params) -> dict[str, list[Blame]]:
    """Return what each fault blames: all sensors and actuators, for an observer isolates none; and the model."""
    parts = [Blame(part.signal, share=0.3) for part in p.output]
    parts += [Blame(part.signal, "actuator", 0.3) for part in p.input]
    parts += [Blame(part.signal, share=0.05) for part in p.input]
    return {fault.name: [*parts, Blame("model", "model")] for fault in _faults(p)}


def _prepare(p: Params, s: State, c: Const) -> None:
    linear_plant.prepare(c.sampling, p)
    level = p.threshold
    stopping.prepare(c.rule, p.rule, level, drift=0.5 * SHIFT, most=4.0 * level)
    c.total = chi2_above(min(p.sample_ms * 1e-3 / p.mtfa_s, 0.4), p.plant.outputs)
    task = records.LEARNING if p.learning else records.WATCHING
    decision.prepare(s.models, c.models, p.told, mtfa_s=p.mtfa_s, start_s=p.start_s, hold_s=p.start_s, task=task)


@kernel
def _judge(s: State, c: Const, j: int, out: Out[Evidence, Record]) -> None:
    """Judge an innovation, in its standard deviations."""
    x = s.models.filters
    alarm = stopping.update(s.rules[j], c.rule, x.e[0, j] / sqrt(x.own[j]))
    e = report(out, 1 + j, alarm, s.rules[j].level, c.rule.threshold)
    e.innovation, e.nis = x.e[0, j], s.nis


@kernel
def _judge_whole(s: State, c: Const, out: Out[Evidence, Record]) -> None:
    """Judge all innovations together."""
    e = report(out, WHOLE, s.nis >= c.total, s.nis, c.total)
    e.innovation, e.nis = sqrt(s.nis), s.nis


@kernel
def _one(s: State, c: Const, u: Inputs, at: int, came: bool, out: Out[Evidence, Record]) -> None:
    """Take one sample, ``at`` samples behind the one before; its outputs came, or it is predicted."""
    linear_plant.take(s, c.sampling, u, at, came)
    x = s.models
    if not decision.step(x, c.models, s.y, s.sampling.u, s.sampling.unsure):
        return
    s.nis = x.filters.square
    if x.tested == 0:
        s.reason = FINDING
        return
    _judge_whole(s, c, out)
    for j in range(c.sampling.outputs):
        _judge(s, c, j, out)


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Record]) -> None:
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
        s.models.filters.aligned.begun = 0
        isolation.restart(s.models, c.models)
    else:
        for k in range(steps - 1):  # each with the command that held then
            _one(s, c, u, k + 1, False, out)
    _one(s, c, u, steps, True, out)
    linear_plant.taken(s)


MONITOR = Monitor(
    type="linear_observer",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    evidence=Evidence,
    step=step,
    connect=linear_plant.connect,
    triggers=linear_plant.triggers,
    prepare=_prepare,
    faults=_faults,
    capabilities=(
        Blames(_blames),
        Readout(("nis", "missing", "restarts", "commands_lost", "untested", "reason")),
        Refinement(wanted, found),
        Sampled(linear_plant.samplings),
    ),
)
