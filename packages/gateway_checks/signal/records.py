"""Records of the monitor of signals: one part looks at the signals of one message."""

from __future__ import annotations

from typing import Annotated

from gateway.monitors.contract import Inputs as Event
from gateway_checks.signal.faults import KINDS
from gateway_checks.signal.params import MOST_CODES, MOST_LEVELS, MOST_RANGES, MOST_SIGNALS, MOST_VALUES
from gateway_fdi.jit import Record, f8, f8s, i4, i4s, i8, means


class Inputs(Event):
    """The signals of a message, and those that say whether one of them must move."""

    value: Annotated[f8s, MOST_SIGNALS] = means("value of each signal")
    other: Annotated[f8s, MOST_SIGNALS] = means("whose being in a range, or movement, asks for movement")
    selector: Annotated[f8s, MOST_SIGNALS, MOST_LEVELS] = means("its multiplexers, the outermost first")


class One(Record):
    """Limits of one signal; those not asked for are infinite."""

    electrical_low: f8 = means("least value that the sensor's circuit gives")
    electrical_high: f8 = means("greatest value that the sensor's circuit gives")
    low: f8 = means("least value")
    high: f8 = means("greatest value")
    hysteresis: f8 = means("inside of a limit that ends a fault")
    gradient: f8 = means("per second")
    least_s: f8 = means("of a step between two values; 0: the usual one", "s")
    patience_ns: i8 = means("for so long a test that has failed counts without another frame", "ns")
    stuck_s: f8 = means("time after which it is stuck", "s")
    stuck_by: f8 = means("change that is none")
    stuck_share: f8 = means("of its values that must differ from the one before; 0: time counts")
    during_low: f8 = means("the other signal's least value that asks for movement")
    during_high: f8 = means("the other signal's greatest value that asks for movement")
    inside_low: f8 = means("value above which it must move")
    inside_high: f8 = means("value below which it must move")
    moving_by: f8 = means("0: time counts")
    deviation: f8 = means("largest standard deviation")
    weight: f8 = means("of a sample in the mean")
    samples: i8 = means("before the mean counts")
    ones: f8 = means("NaN: not asked for")
    codes: i4 = means("codes that say that it is invalid")
    values: i4 = means("values that are allowed; 0: all")
    code: Annotated[f8s, MOST_CODES] = means("these codes")
    allowed: Annotated[f8s, MOST_VALUES] = means("these values")
    missing_s: f8 = means("time without it after which it is missing", "s")
    levels: i4 = means("multiplexers that select it; 0: it is in every frame")
    ranges: Annotated[i4s, MOST_LEVELS] = means("ranges of each multiplexer that select it")
    least: Annotated[f8s, MOST_LEVELS, MOST_RANGES] = means("values of a multiplexer that select it")
    greatest: Annotated[f8s, MOST_LEVELS, MOST_RANGES] = means("likewise, the other end of each range")
    fault: Annotated[i4s, len(KINDS)] = means("number of each fault; -1: not asked for")


class Const(Record):
    """Limits of the signals."""

    signals: i8 = means("signals of the message")
    one: Annotated[list[One], MOST_SIGNALS] = means("what is asked of each")


class Course(Record):
    """Memory of one signal."""

    valid: i8 = means("values so far, since the last that was none")
    before: f8 = means("last value")
    second: f8 = means("value before that")
    before_ns: i8 = means(unit="ns")
    anchor: f8 = means("where it last moved to")
    still_s: f8 = means("how long it has been there while it should move", "s")
    other: f8 = means("what the other signal was then")
    moved: f8 = means("share of the last values that differ from the one before")
    least: f8 = means("what that share were if nothing had moved since it began")
    tested: i8 = means("1: its movement was tested at the last value that said anything")
    variance: f8 = means("mean of the squared scatter")
    usual_s: f8 = means("mean time from one value to the next", "s")
    even: i8 = means("values so far, since the last that was none, or came after a gap")
    frame_ns: i8 = means("when its message last came; 0: never", "ns")
    away_s: f8 = means("how long its message has come without it", "s")
    failed: i8 = means("bits of the kinds that failed last")
    came_ns: i8 = means("when a value came last, whatever it said; 0: never", "ns")
    beyond: Annotated[i4s, len(KINDS)] = means("1: beyond a limit, until it is back by the hysteresis")


class State(Record):
    """Memory of the signals."""

    one: Annotated[list[Course], MOST_SIGNALS] = means("what is remembered of each")


class Evidence(Record):
    """Values that a test looked at."""

    value: f8 = means("value")
    before: f8 = means("before")
