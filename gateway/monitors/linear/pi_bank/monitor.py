"""Bank of PI observers: each actuator and each sensor of a linear plant, with the size of its fault.

Source: Kim, Kim, Kawaji, "Fault Diagnosis of Actuators and Sensors with multiple PI observers" (paper 003), designed in
discrete time, with (16) corrected (:mod:`gateway.fdi.pi_bank.products`) and decisions of its own
(:mod:`gateway.fdi.pi_bank.isolation`). One step a sample; samples that are lost are predicted.
"""

from __future__ import annotations

from typing import Annotated

from gateway.fdi.pi_bank import bank, isolation, products
from gateway.fdi.pi_bank.isolation import NONE, settled
from gateway.fdi.pi_bank.masking import masked
from gateway.jit import Record, f8, f8s, i8, kernel, labels, means
from gateway.monitors.contract import (
    TIMER,
    Debounce,
    Fault,
    Monitor,
    Out,
    Readout,
    Warnings,
    report,
)
from gateway.monitors.linear import plant as linear_plant
from gateway.monitors.linear.pi_bank.params import Params


class Const(Record):
    """Constants."""

    sampling: linear_plant.Const
    isolation: isolation.Const
    products: i8
    start: i8


class State(Record):
    """State."""

    sampling: linear_plant.State
    isolation: isolation.State
    samples: i8
    missing: i8
    restarts: i8
    active: i8
    sensor: i8


class Evidence(Record):
    """Evidence of each fault."""

    magnitude: f8 = means("size of the fault")
    observer: f8 = means("observer in use")
    innovation: Annotated[f8s, bank.MOST_OUTPUTS]


#: What cannot be isolated comes first; then actuators, then sensors.
UNEXPLAINED = 0

#: Verdicts have been persistent already.
_FOUND = Debounce(failed_after=1, passed_after=5)


def _faults(p: Params) -> tuple[Fault, ...]:
    left = tuple(f"innovation of {name}" for name in p.sensor_names)
    evidence = (*labels(Evidence)[:2], *left)
    found = [
        Fault(
            "unexplained",
            "C1B10-62",
            "sensors contradict each other in a way that no single sensor and no actuator explains",
            evidence,
            _FOUND,
        )
    ]
    for k, part in enumerate(p.input, start=1):
        text = f"actuator {part.name}: does something else than it is commanded"
        found.append(Fault(f"actuator_{part.name}", part.dtc or f"C1B1{k}-64", text, evidence, _FOUND))
    for k, sensor in enumerate(p.output, start=1):
        text = f"sensor {sensor.name}: contradicts the others"
        found.append(Fault(f"sensor_{sensor.name}", sensor.dtc or f"C1B2{k}-64", text, evidence, _FOUND))
    return tuple(found)


def _prepare(p: Params, s: State, c: Const) -> None:
    linear_plant.prepare(c.sampling, p)
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
    c.products = p.logic == "products"
    c.start = max(round(p.start_s / p.plant.period), 1)
    s.sensor = NONE
    isolation.restart(s.isolation, c.isolation)


@kernel
def _report(s: State, fault: int, failed: bool, value: float, limit: float, out: Out[Evidence, Record]) -> None:
    """Report a test with size and innovations as evidence."""
    e = report(out, fault, failed, abs(value), limit)
    if not failed:
        return
    x = s.isolation
    e.magnitude, e.observer = value, float(x.active)
    for j in range(bank.MOST_OUTPUTS):
        e.innovation[j] = x.bank.e[x.active, j]


@kernel
def _conclude(s: State, c: Const, out: Out[Evidence, Record]) -> None:
    """Report what the isolation has found."""
    x, o = s.isolation, c.isolation.bank
    if x.unexplained == 1:
        _report(s, UNEXPLAINED, True, 1.0, 0.0, out)
        return
    if x.tested == 0:
        return
    _report(s, UNEXPLAINED, False, 0.0, 0.0, out)
    for i in range(o.m):
        _report(s, 1 + i, x.actuator[i] == 1, x.fault[i], x.limit[i], out)
    for j in range(o.p):
        failed = x.latched == j and x.confirmed == 1
        _report(s, 1 + o.m + j, failed, x.offset[j], c.isolation.sensor[j], out)


@kernel
def _products(s: State, c: Const, u: linear_plant.Inputs, out: Out[Evidence, Record]) -> None:
    """Take one sample by the paper's own logic."""
    x, o = s.isolation, c.isolation.bank
    if x.started == 0:
        s.samples += 1
        if s.samples >= c.start:
            x.started = 1
        bank.step(x.bank, o, u.y, u.u)
        return
    for k in range(o.p + 1):
        bank.innovate(x.bank, o, k, u.y)
    x.latched = NONE
    for i in range(o.m):
        limit = c.isolation.actuator[i]
        x.fault[i] = x.bank.z[0, o.n + i]
        flag = products.actuator(x.bank.z, o.n, o.p, i, limit, False)
        x.actuator[i] = 1 if flag else 0
        _report(s, 1 + i, flag, x.fault[i], limit, out)
    for j in range(o.p):
        limit = c.isolation.sensor[j]
        flag = products.sensor(x.bank.e, o.p, j, limit)
        if flag:
            x.latched = j
        _report(s, 1 + o.m + j, flag, x.bank.e[0, j], limit, out)
    for k in range(o.p + 1):
        bank.advance(x.bank, o, k, u.u)


@kernel
def step(s: State, c: Const, u: linear_plant.Inputs, out: Out[Evidence, Record]) -> None:
    """Take one sample."""
    if u.trigger == TIMER:
        return
    steps = linear_plant.samples(s.sampling, c.sampling, u)
    if steps == 0:
        return
    x = s.isolation
    if steps - 1 > linear_plant.MOST_MISSING:
        s.restarts += 1
        s.samples = 0
        isolation.restart(x, c.isolation)
    else:
        for _ in range(steps - 1):
            s.missing += 1
            isolation.missing(x, c.isolation, u.u)
    if c.products == 1:
        _products(s, c, u, out)
    else:
        isolation.step(x, c.isolation, u.y, u.u)
        _conclude(s, c, out)
    s.active, s.sensor = x.active, x.latched


def _warnings(p: Params) -> tuple[str, ...]:
    """Say which faults hide each other from stationary values, and how slow the bank is."""
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
    slowest = max(settled(p.plant, observer) for observer in p.observers)
    if p.start_s < 1.0 and p.logic == "products":
        said.append(f"start_s = {p.start_s}: the observers settle with {slowest:.2g} s")
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
    capabilities=(Readout(("active", "sensor", "missing", "restarts")), Warnings(_warnings)),
)
