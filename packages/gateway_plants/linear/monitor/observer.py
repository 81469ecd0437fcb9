"""Any linear plant by configuration: one observer, and what it leaves of each sensor.

    e(k) = y(k) - C x(k),   x(k+1) = Phi x(k) + Gamma u(k) + L e(k)

Each innovation, in its own standard deviations, goes through a stopping rule (:mod:`gateway_fdi.stopping`), and so does
the normalised innovation squared e^T V^-1 e of all of them. It detects; it does not isolate: a fault of one sensor
moves the observer, and shows in the others (paper 003, section 4.1). For that there is ``pi_bank``.

Two ways, one choice:

without ``model_error``   the gain L, constant, for a plant that is what its matrices say. A sample or a command that is
                          lost leaves an error that no constant threshold knows: nothing is judged until it has gone.
with ``model_error``      the healthy hypothesis of the bank (:mod:`gateway_plants.linear.model_set`): a Kalman filter
with the
                          errors of the matrices as slow states. The covariance of its innovations, V, grows with what
                          the plant does, with samples and commands that are lost, and shrinks as the errors are
                          learned; the rules are the same.
"""

from __future__ import annotations

from cmath import exp
from functools import cached_property
from math import nan, sqrt
from typing import Annotated, Literal, Self

import numpy as np
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
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, labels, means
from gateway_fdi.linear_algebra import copy, square
from gateway_fdi.quantiles import chi2_above
from gateway_plants.linear.mathematics.gains import Gain, from_noise, from_poles, settling
from gateway_plants.linear.model_set import decision
from gateway_plants.linear.model_set.design import COMMAND_SIZE
from gateway_plants.linear.monitor import plant as linear_plant
from gateway_plants.linear.monitor.plant import COMMAND, FINDING, MOST_MISSING, SETTLING, Inputs
from gateway_plants.linear.monitor.refine import found, wanted
from gateway_plants.linear.monitor.uncertain import UncertainPlantParams
from gateway_plants.linear.pi_bank import bank
from gateway_plants.linear.pi_bank.bank import MOST_OUTPUTS
from gateway_plants.linear.pi_bank.design import Observer


class Const(Record):
    """Constants."""

    sampling: linear_plant.Const = means("samples off the bus")
    uncertain: i8 = means("1: by models")
    models: decision.Const = means("with model_error: the healthy hypothesis")
    blind: Annotated[i8s, MOST_MISSING + 1] = means("samples that are not judged behind so many missing ones in a row")
    blind_command: i8 = means("samples that are not judged behind a lost command")
    bank: bank.Const = means("the observer, of all sensors, without faults of actuators")
    weight: Annotated[f8s, MOST_OUTPUTS, MOST_OUTPUTS] = means("V^-1")
    spread: Annotated[f8s, MOST_OUTPUTS] = means("standard deviation of each innovation")
    rule: stopping.Const = means("stopping rule of each innovation")
    total: f8 = means("threshold of e^T V^-1 e")
    start: i8 = means("samples in which nothing is judged")


class State(Record):
    """State."""

    sampling: linear_plant.State = means("samples off the bus")
    models: decision.State = means("with model_error: the healthy hypothesis")
    x: Annotated[f8s, bank.MOST] = means("the observer's estimate, and faults of actuators, which are 0")
    work: Annotated[f8s, bank.MOST] = means("scratch")
    e: Annotated[f8s, MOST_OUTPUTS] = means("what it leaves of each sensor")
    rules: Annotated[list[stopping.State], MOST_OUTPUTS] = means("stopping rule of each innovation")
    nis: f8 = means("normalised innovation squared")
    samples: i8 = means("samples taken since the start")
    missing: i8 = means("samples that did not come")
    commands_lost: i8 = means("samples whose command did not come")
    restarts: i8 = means("times that all began anew")
    untested: i8 = means("samples that were not judged")
    reason: i8 = means("why the last sample was not judged, see monitors/linear/plant.py; 0: it was")
    blind: i8 = means("samples that are still not judged")


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

    poles: tuple[float | tuple[float, float], ...] | None = Field(
        None,
        description="n, continuous: -1.2, or [-1.0, 2.0] for one of a pair [1/s]; default: Kalman's, from the noise",
    )
    rule: Literal["direct", "cusum"] = Field("direct", description="what makes an alarm of an innovation")
    level: float | None = Field(
        None,
        gt=0,
        description="of the rule, in standard deviations of the innovation; default: from mtfa_s",
    )
    start_s: float = Field(5.0, ge=0, description="at the start nothing is judged for so long [s]")

    @model_validator(mode="after")
    def _observable(self) -> Self:
        if self.uncertain:
            self.check_filters(poles=self.poles is not None)
        else:
            self.check_observable()
            _ = self.observer
        return self

    @property
    def uncertain(self) -> bool:
        """Whether the matrices are not taken as exact."""
        return self.model_error is not None

    @cached_property
    def observer(self) -> Gain:
        """The observer."""
        plant = self.plant
        q = np.diag(np.array(self.disturbance) ** 2 * plant.period)
        r = np.diag(np.array([part.noise for part in self.output]) ** 2)
        if self.poles is None:
            return from_noise(plant.phi, plant.c, q, r)
        given = [complex(*pole) if isinstance(pole, tuple) else complex(pole) for pole in self.poles]
        return from_poles(plant.phi, plant.c, tuple(exp(g * plant.period) for g in given), q, r)

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
    plant = p.plant
    n, q = plant.states, plant.outputs
    linear_plant.prepare(c.sampling, p)
    bank.prepare(c.bank, plant, () if p.uncertain else (Observer(None, p.observer),))
    level = p.threshold
    stopping.prepare(c.rule, p.rule, level, drift=0.5 * SHIFT, most=4.0 * level)
    c.total = chi2_above(min(p.sample_ms * 1e-3 / p.mtfa_s, 0.4), q)
    c.start = round(p.start_s / plant.period)
    c.uncertain = p.uncertain
    if p.uncertain:
        task = decision.LEARNING if p.learning else decision.WATCHING
        decision.prepare(s.models, c.models, p.told, mtfa_s=p.mtfa_s, start_s=p.start_s, hold_s=p.start_s, task=task)
        return
    observer = p.observer
    c.weight[:q, :q] = np.linalg.inv(observer.innovation)
    c.spread[:q] = np.sqrt(np.diag(observer.innovation))
    noise = np.diag(np.array(p.disturbance) ** 2 * plant.period)
    more = np.zeros((n, n))
    for k in range(MOST_MISSING):
        # Without a correction the error is Phi P Phi' + Q instead of what the observer makes of it, sample by sample.
        more = plant.phi @ (observer.error + more) @ plant.phi.T + noise - observer.error
        c.blind[k + 1] = settling(plant.phi, plant.c, observer, more)
    unknown = plant.gamma * (COMMAND_SIZE * p.actuator_limits)
    c.blind_command = settling(plant.phi, plant.c, observer, unknown @ unknown.T)


@kernel(inlined=False)
def _advance(s: State, c: Const, u: f8s) -> None:
    """Step the observer to the next sample."""
    bank.onwards(s.x, s.e, c.bank.gain[0], c.bank, u, s.work)


@kernel
def _lost(s: State, c: Const, u: Inputs, at: int) -> bool:
    """Find the commands of a sample; tells whether one is lost."""
    lost = linear_plant.command_lost(s.sampling, c.sampling, u, at)
    if lost:
        s.commands_lost += 1
        if c.uncertain == 0:
            s.blind, s.reason = max(s.blind, c.blind_command), COMMAND
    return bool(lost)


@kernel
def _skip(s: State, c: Const, u: Inputs, steps: int) -> None:
    """Go on over the samples that did not come, each with the command that held then."""
    if steps - 1 > MOST_MISSING or s.sampling.gap == 1:
        s.restarts += 1
        s.samples = 0
        if c.uncertain == 1:
            s.models.filters.aligned.begun = 0
            decision.restart(s.models, c.models)
        return
    s.e[:] = nan if c.uncertain == 1 else 0.0
    for k in range(steps - 1):
        s.missing += 1
        _lost(s, c, u, k + 1)
        if c.uncertain == 1:
            decision.step(s.models, c.models, s.e, s.sampling.u, s.sampling.unsure)
        else:
            _advance(s, c, s.sampling.u)
    if c.uncertain == 0 and steps > 1 and s.blind < c.blind[steps - 1]:
        s.blind, s.reason = c.blind[steps - 1], SETTLING


@kernel
def _judge(s: State, c: Const, j: int, share: float, out: Out[Evidence, Record]) -> None:
    """Judge an innovation, in its standard deviations."""
    alarm = stopping.update(s.rules[j], c.rule, share)
    e = report(out, 1 + j, alarm, s.rules[j].level, c.rule.threshold)
    e.innovation, e.nis = s.e[j], s.nis


@kernel
def _judge_whole(s: State, c: Const, out: Out[Evidence, Record]) -> None:
    """Judge all innovations together."""
    e = report(out, WHOLE, s.nis >= c.total, s.nis, c.total)
    e.innovation, e.nis = sqrt(s.nis), s.nis


@kernel
def _uncertain(s: State, c: Const, u: Inputs, out: Out[Evidence, Record]) -> None:
    """Take one sample with the filter."""
    x = s.models
    if not decision.step(x, c.models, u.y, s.sampling.u, s.sampling.unsure):
        return
    s.nis = x.filters.square
    copy(s.e, x.filters.e[0], c.bank.p)
    if x.tested == 0:
        s.reason = FINDING
        return
    _judge_whole(s, c, out)
    for j in range(c.bank.p):
        _judge(s, c, j, s.e[j] / sqrt(x.filters.own[j]), out)


@kernel
def _exact(s: State, c: Const, u: Inputs, out: Out[Evidence, Record]) -> None:
    """Take one sample with the observer."""
    bank.left(s.x, s.e, c.bank, 0, u.y)
    s.nis = square(s.e, c.weight, c.bank.p)
    s.samples += 1
    if s.samples > c.start and s.blind == 0:
        s.reason = 0
        _judge_whole(s, c, out)
        for j in range(c.bank.p):
            _judge(s, c, j, s.e[j] / c.spread[j], out)
    elif s.blind > 0:
        s.blind -= 1
    else:
        s.reason = FINDING


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Record]) -> None:
    """Take one sample."""
    if u.trigger == TIMER or linear_plant.command(s.sampling, c.sampling, u):
        return
    steps = linear_plant.samples(s.sampling, c.sampling, u)
    if steps == 0:
        return
    _skip(s, c, u, steps)
    # A command that is lost now acts from this sample on: the present one is judged as ever.
    if c.uncertain == 1:
        _lost(s, c, u, steps)
        s.reason = 0
        _uncertain(s, c, u, out)
    else:
        _exact(s, c, u, out)
        _lost(s, c, u, steps)
        _advance(s, c, s.sampling.u)
    linear_plant.heard_all(s.sampling, c.sampling)
    if s.reason > 0:
        s.untested += 1


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
