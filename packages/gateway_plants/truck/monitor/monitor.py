"""The hybrid powertrain's monitor: a step for each complete set of four frames.

Source: paper 004. Corrections: docs/structure.md, and the modules of this folder. A set is complete when frames of its
counter have come of all four messages (:class:`gateway.monitors.contract.Sampled`); time is the counter's steps, not
the frames' arrival. A set that is missing is stepped over; after a gap of more than :data:`LONGEST` sets T7 begins
again.
"""

from __future__ import annotations

from gateway.monitors.contract import (
    TIMER,
    Behind,
    Blame,
    Blames,
    CusumCalibration,
    Evidence,
    Fault,
    Monitor,
    Out,
    Quantities,
    Quantity,
    Readout,
    Sampled,
)
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import kernel
from gateway_fdi.structure.file import load_model
from gateway_plants.truck.monitor import alignment, blanking, decision, gate, isolation, motion, observer, static
from gateway_plants.truck.monitor.faults import BLAMES, behind, faults_of
from gateway_plants.truck.monitor.generated import t2, t6, t7
from gateway_plants.truck.monitor.messages import Inputs, connect, sampling
from gateway_plants.truck.monitor.params import QUANTITIES, Params
from gateway_plants.truck.monitor.records import RESIDUAL_NAMES, Const, State, peaks, prepare, sums

#: Sets that may be missing in a row.
LONGEST = 5
#: Sets between two messages.
SENT = 10


def _faults(_: Params) -> tuple[Fault, ...]:
    return faults_of(isolation.TESTS)


def _behind(_: Params) -> dict[str, list[Blame]]:
    return behind(isolation.seen_by(load_model(shipped("models/truck.toml")), isolation.TESTS))


@kernel
def begin(s: State, c: Const, u: Inputs) -> None:
    """Begin with the first set."""
    t2.reset(s.t2, c.t2)
    t2.start(s.t2, c.t2, u)
    t6.reset(s.t6, c.t6)
    t6.start(s.t6, c.t6, u)
    t7.reset(s.t7, c.t7)
    s.t2.SoC, s.t6.SoC = u.charge, u.charge
    s.blanking.gear = int(u.gear)


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, decision.Outputs]) -> None:
    """Step all tests with a set."""
    if u.trigger == TIMER:
        return
    steps = int(u.gap) if s.sets > 0 else 0
    if s.sets == 0:
        begin(s, c, u)
    elif steps > LONGEST:
        gate.restart(s.gate)
        blanking.forget(s.blanking, c.blank)
        s.watched, steps = 0, 0
    s.sets += 1
    dt = steps * c.period
    alignment.align(s.alignment, u, steps, c.most_lag, c.voltage_noise)
    s.lag_ms = s.alignment.lag.lag * c.period * 1e3
    static.step(s, c, s.alignment.out, dt)
    motion.step(s, c, s.alignment.out, dt)
    decision.decide(s, c, dt, out)
    if s.sets % SENT == 0:
        decision.tell(s, out)


MONITOR = Monitor(
    type="hybrid_powertrain",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    outputs=decision.Outputs,
    step=step,
    connect=connect,
    prepare=prepare,
    faults=_faults,
    emits=decision.emits,
    capabilities=(
        Behind(_behind, lambda _, s: isolation.levels(s)),
        Blames(lambda _: BLAMES),
        CusumCalibration(
            quantities=(*((name, name) for name in QUANTITIES), ("T7", "")),
            floors={"T7": observer.FLOOR},
            sums=sums,
            peaks=peaks,
        ),
        Quantities(
            lambda _: (
                *(Quantity(f"residual of {name}") for name in RESIDUAL_NAMES),
                *(Quantity(f"T over J of {name}", limit=1.0) for name in isolation.TESTS),
            ),
            lambda s: (*s["residual"], *s["level"]),
        ),
        Sampled(sampling),
        Readout(
            (
                "sets",
                "valid",
                "fired",
                "explained",
                "untested",
                "winding",
                "magnets",
                "open_volts",
                "cells",
                "lag_ms",
            )
        ),
    ),
)
