"""Battery voltage: too low, or too high, at a terminal that a message carries.

A monitor reports test results; debounce, DTC and fault memory are the gateway's. See docs/monitors.md.
"""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import Field

from gateway.monitors import contract
from gateway.monitors.contract import (
    TIMER,
    Connection,
    Debounce,
    Fault,
    Monitor,
    MonitorParams,
    Out,
    Readout,
    Signal,
    report,
)
from gateway_fdi.jit import Record, f8, kernel, labels, means


class Params(MonitorParams):
    """Keys of the table ``[[monitor]]``."""

    signal: str = Field("BATT.Voltage", description='"Message.Signal" of the terminal voltage')
    low: float = Field(11.0, description="below it the battery is too low [V]")
    high: float = Field(15.5, description="above it the battery is charged too much [V]")
    hysteresis: float = Field(0.5, ge=0, description="back by so much it is good again [V]")


class State(Record):
    """What a step leaves for the next."""

    lowest: f8 = means("lowest voltage so far", "V")


class Const(Record):
    """What stays."""

    low: f8 = means("below it the battery is too low", "V")
    high: f8 = means("above it the battery is charged too much", "V")
    hysteresis: f8 = means("back by so much it is good again", "V")


class Inputs(contract.Inputs):
    """What a step gets, by name."""

    volts: f8 = means("terminal voltage", "V")


class Evidence(Record):
    """What is kept with a result."""

    volts: f8 = means("terminal voltage", "V")
    lowest: f8 = means("lowest so far", "V")


LOW, HIGH = range(2)


def faults(_: Params) -> tuple[Fault, ...]:
    """Return what it can report, in the order of the numbers above; failure types 16, 17 of SAE J2012-DA."""
    debounce = Debounce(failed_after=5, passed_after=5)
    return (
        Fault("low", "P0562-16", "battery voltage below its limit", labels(Evidence), debounce, tested="voltage [V]"),
        Fault("high", "P0563-17", "battery voltage above its limit", labels(Evidence), debounce, tested="voltage [V]"),
    )


def connect(p: Params) -> Mapping[str, Connection]:
    """Return what each input is connected to; a frame that carries a triggering signal steps the monitor."""
    return {"volts": Signal(p.signal, unit="V", triggers=True)}


def prepare(p: Params, s: State, c: Const) -> None:
    """Fill state and constants before the first step."""
    c.low, c.high, c.hysteresis = p.low, p.high, p.hysteresis
    s.lowest = float("inf")


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Record]) -> None:
    """Take one voltage. Within the hysteresis nothing is reported, and the debounce holds."""
    if u.trigger == TIMER:
        return
    s.lowest = min(s.lowest, u.volts)
    if not c.low <= u.volts < c.low + c.hysteresis:
        e = report(out, LOW, u.volts < c.low, u.volts, c.low)
        e.volts, e.lowest = u.volts, s.lowest
    if not c.high - c.hysteresis < u.volts <= c.high:
        e = report(out, HIGH, u.volts > c.high, u.volts, c.high)
        e.volts, e.lowest = u.volts, s.lowest


MONITOR = Monitor(
    type="battery_voltage",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    evidence=Evidence,
    step=step,
    connect=connect,
    prepare=prepare,
    faults=faults,
    capabilities=(Readout(("lowest",)),),
)
