"""Clocks of senders: a periodic message whose clock changes has another sender (see :mod:`gateway_fdi.clock`).

It is a suspicion, not a fault, unless a code is configured. A message that changes alone names itself. Where more
than a third change together it is the receiver's clock, or that of an ECU that sends that many: this is counted, and
nobody is suspected.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from gateway.monitors import contract
from gateway.monitors.contract import (
    TIMER,
    Connection,
    Debounce,
    Fault,
    Monitor,
    MonitorParams,
    Notes,
    Numbered,
    Out,
    Readout,
    Suspects,
    report,
)
from gateway_fdi import clock
from gateway_fdi.clock import Clock, close_window, is_steady, judge, sort, take
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, labels, means

#: Messages of one monitor, and how many have to be steady, so that the receiver's own clock can be told from theirs.
MOST, FEWEST = 64, 5
#: A walk that is older than this says nothing of the receiver's clock now.
FRESH_S = 5.0
#: Part of the limit from which on a suspicion has ended.
RELEASED = 0.5


class Params(MonitorParams):
    """Keys of the table ``[[monitor]]``."""

    messages: tuple[str, ...] = Field(min_length=FEWEST, max_length=MOST, description="periodic messages of one bus")
    code: str | None = Field(
        None, pattern=r"^[PCBU][0-3][0-9A-F]{3}$", description="base code of a DTC; default: no DTC, it is told alone"
    )
    learn_s: float = Field(120.0, ge=10, le=3600, description="a message is only listened to for this time [s]")
    memory_s: float = Field(600.0, ge=10, le=36000, description="skews are forgotten with this time constant [s]")
    noise_ms: float = Field(0.1, gt=0, le=100, description="noise of the times of frames [ms]")
    drift_ppm: float = Field(15.0, gt=0, le=1000, description="change of a skew that is borne for ever [1e-6]")
    limit_ms: float = Field(5.0, gt=0, le=1000, description="how far a phase may walk beyond that [ms]")

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        for k, name in enumerate(self.messages):
            if name in self.messages[:k]:
                raise ValueError(f"messages: {name} is there twice")
        return self


class State(Record):
    """Memory of the monitor."""

    clock: Annotated[list[Clock], MOST] = means("of each message")
    heard_s: Annotated[f8s, MOST] = means("end of the last window that was followed, counted from the first frame", "s")
    alarmed: Annotated[i8s, MOST] = means("whether its clock has changed")
    scratch: Annotated[f8s, MOST] = means("walks, to be sorted", "s")
    common: f8 = means("how far the receiver's clock has walked", "s")
    began_ns: i8 = means("first frame; 0: none has come", "ns")
    suspicions: i8 = means("how often a clock has changed")
    suspected: i8 = means("place of the message that changed last, from 1; 0: none has")
    suspected_ns: i8 = means("when that was", "ns")
    together: i8 = means("how often more than a third changed at once")
    steady: i8 = means("messages that are judged")


class Const(clock.Const):
    """Its limits."""

    messages: i8 = means("how many")
    coded: i8 = means("1: it is reported as a fault")
    rows: Annotated[i8s, MOST] = means("number of each message, as the cause of a step has it")


class Evidence(Record):
    """Values that are kept with a result."""

    message: f8 = means("place among messages, from 1")
    period: f8 = means("its period", "ms")
    walked: f8 = means("how far its phase has walked beyond its clock", "ms")
    steady: f8 = means("messages that are judged")


@kernel
def note_common(s: Any, c: Any, now_s: float) -> bool:
    """Find how far the receiver's clock has walked, by the median of the messages; returns whether there are enough."""
    count = s.steady = 0
    for k in range(c.messages):
        s.steady += 1 if is_steady(s.clock[k]) else 0
        if is_steady(s.clock[k]) and now_s - s.heard_s[k] < FRESH_S:
            s.scratch[count] = s.clock[k].walk - s.clock[k].own
            count += 1
    if count < FEWEST:
        return False
    sort(s.scratch, count)
    middle = count // 2
    s.common = s.scratch[middle] if count % 2 == 1 else 0.5 * (s.scratch[middle - 1] + s.scratch[middle])
    return True


@kernel
def change_together(s: Any, c: Any) -> bool:
    """Return whether more than a third of the messages have walked by half the limit: their CUSUMs begin again then."""
    walked = 0
    for k in range(c.messages):
        walked += 1 if s.alarmed[k] == 0 and max(s.clock[k].up, s.clock[k].down) > 0.5 * c.limit_s else 0
    if 3 * walked <= s.steady:
        return False
    s.together += 1
    for k in range(c.messages):
        if s.alarmed[k] == 0:
            s.clock[k].up = s.clock[k].down = 0.0
    return True


@kernel
def report_test(s: Any, c: Any, out: Any, k: int, t_ns: int, ratio: float) -> None:
    """Take a judgement of a message, count a new suspicion, and report it."""
    failed = ratio >= (1.0 if s.alarmed[k] == 0 else RELEASED)
    if failed and s.alarmed[k] == 0:
        s.suspicions += 1
        s.suspected = k + 1
        s.suspected_ns = t_ns
    s.alarmed[k] = 1 if failed else 0
    alarmed = 0
    for j in range(c.messages):
        alarmed += s.alarmed[j]
    if c.coded == 1 and (failed or alarmed == 0):
        evidence = report(out, 0, failed, ratio * c.limit_s * 1e3, c.limit_s * 1e3)
        evidence.message = k + 1
        evidence.period = s.clock[k].period * 1e3
        evidence.walked = ratio * c.limit_s * 1e3
        evidence.steady = s.steady


@kernel
def step(s: State, c: Const, u: contract.Inputs, out: Out[Evidence, Record]) -> None:
    """Take the time of one frame."""
    if u.trigger == TIMER:
        return
    k = 0
    while k < c.messages and c.rows[k] != u.trigger:
        k += 1
    if k == c.messages:
        return
    if s.began_ns == 0:
        s.began_ns = u.t_ns
    one = s.clock[k]
    if not take(one, u.t_ns, c.noise_s, s.common):
        return
    now_s = (u.t_ns - s.began_ns) * 1e-9
    enough = note_common(s, c, now_s)
    dt = close_window(one, c, s.common)
    if dt <= 0.0:
        return
    s.heard_s[k] = now_s
    if not enough or not is_steady(one):
        return
    ratio = judge(one, c, dt)
    if ratio > 0.5 and change_together(s, c):
        return
    report_test(s, c, out, k, u.t_ns, ratio)


def faults(p: Params) -> tuple[Fault, ...]:
    """Return what it reports: nothing without a code."""
    if p.code is None:
        return ()
    return (
        Fault(
            "sender",
            f"{p.code}-62",
            "the clock of a message's sender has become another one: it may have been replaced",
            labels(Evidence),
            Debounce(failed_after=1, passed_after=1),
            remedy="find out which ECU sends it; look for a device that was added",
            tested="walk of its phase [ms]",
        ),
    )


def prepare(p: Params, s: State, c: Const) -> None:
    """Fill state and constants before the first step."""
    c.messages, c.coded = len(p.messages), p.code is not None
    c.memory_s, c.learn_s, c.noise_s = p.memory_s, p.learn_s, p.noise_ms * 1e-3
    c.kappa, c.limit_s = p.drift_ppm * 1e-6, p.limit_ms * 1e-3
    c.rows[:] = -1


def connect(_: Params) -> Mapping[str, Connection]:
    """Return no input: when its messages come is all that it wants."""
    return {}


def _notes(p: Params) -> tuple[str, ...]:
    how = f"with the DTC {p.code}-62" if p.code else "without a DTC"
    return (f"clocks of {len(p.messages)} messages; another sender of one is a suspicion, told {how}",)


MONITOR = Monitor(
    type="sender_clock",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=contract.Inputs,
    evidence=Evidence,
    step=step,
    connect=connect,
    prepare=prepare,
    faults=faults,
    triggers=lambda p: p.messages,
    capabilities=(
        Readout(("steady", "suspicions", "suspected", "together")),
        Notes(_notes),
        Numbered("rows"),
        Suspects("suspicions", "suspected", "suspected_ns", lambda p: p.messages),
    ),
)
