"""From symptoms to the component at fault: a signature table, and what stands until its symptoms are gone.

Signature of a single fault, by residual:

    component             increment   EMF's angle   parity (1)   own rate   balance, NIS
    motor angle sensor        x            x            x            -           -
    steering wheel angle      -            -            x            x           -
    pinion angle              -            -            x            -           -
    currents, voltages        -            -            -            -           x

:data:`SIGNATURES` is this table with the ways in which the motor's sensor fails, in the binary symptoms of
:mod:`gateway.monitors.steering.symptoms`.

At rest the EMF is silent: a parity that grows there belongs to one of three angles, and is reported so; the next
motion tells which. The sensors are in a closed loop: the motor follows a wrong angle, and the pinion tells of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gateway.jit import Record, i8, kernel
from gateway.monitors.steering import symptoms
from gateway.monitors.steering.faults import (
    ANGLES,
    CURRENT,
    DRIFT,
    ELECTRIC,
    IMPLAUSIBLE,
    INTERMITTENT,
    NOISE,
    OFFSET,
    PAIRING,
    PINION,
    SCALE,
    STUCK,
    VOLTAGE,
    WHEEL,
)
from gateway.monitors.steering.params import Params
from gateway.monitors.steering.symptoms import (
    BOTH_SIGNS,
    CURRENT_FROZEN,
    ELECTRIC_MISFIT,
    EMF_CONSISTENT,
    EMF_CONTRADICTS,
    EXCEEDS,
    FREQUENT,
    GROWS_WITH_ANGLE,
    GROWS_WITH_TIME,
    IN_PARITY,
    JUMP,
    LASTING,
    MEAN_SQUARE,
    NET_STEP,
    NIS_FIRST,
    PARITY,
    PARITY_ALARM,
    RATE,
    RATE_CONSISTENT,
    RATE_CONTRADICTS,
    REPEATS,
    RESTLESS,
    RETURNS,
    STEP_AT_ONCE,
    STEP_DELAYED,
    SUDDEN,
    SURPRISE,
)

#: Nothing found.
NONE = -1

#: Faults that a finding may take the place of: none; one that is not known better.
_NOTHING = (NONE,)
_VAGUE = (NONE, ANGLES, IMPLAUSIBLE)
#: What the motor's sensor shows by itself stands beside whatever the gear has said before.
_GEAR = (*_VAGUE, WHEEL, PINION)
_UNKNOWN_ELECTRIC = (NONE, ELECTRIC)


class Signature(NamedTuple):
    """Symptoms of a fault; those that are not named do not matter.

    Attributes:
        fault: by its place.
        replaces: faults, or NONE, that stand when it may be found.
        on: symptoms that must be on.
        off: symptoms that must be off.
    """

    fault: int
    replaces: tuple[int, ...]
    on: int
    off: int = 0


#: The first one that fits decides.
SIGNATURES = (
    Signature(STUCK, _GEAR, on=REPEATS),
    # A jump that the gear has not made, and that stays.
    Signature(OFFSET, _GEAR, on=EXCEEDS | IN_PARITY),
    Signature(OFFSET, _GEAR, on=SUDDEN, off=RETURNS),
    Signature(NOISE, _GEAR, on=FREQUENT | BOTH_SIGNS, off=NIS_FIRST),
    Signature(NOISE, _GEAR, on=MEAN_SQUARE, off=EXCEEDS | NIS_FIRST),
    Signature(OFFSET, _GEAR, on=EXCEEDS | NET_STEP, off=BOTH_SIGNS | NIS_FIRST),
    Signature(INTERMITTENT, _GEAR, on=BOTH_SIGNS, off=NIS_FIRST),
    Signature(CURRENT, _UNKNOWN_ELECTRIC, on=ELECTRIC_MISFIT | CURRENT_FROZEN, off=PARITY_ALARM),
    Signature(CURRENT, _UNKNOWN_ELECTRIC, on=ELECTRIC_MISFIT | STEP_AT_ONCE, off=PARITY_ALARM),
    Signature(VOLTAGE, _UNKNOWN_ELECTRIC, on=ELECTRIC_MISFIT | STEP_DELAYED, off=PARITY_ALARM),
    Signature(ELECTRIC, _UNKNOWN_ELECTRIC, on=ELECTRIC_MISFIT, off=PARITY_ALARM),
    Signature(SCALE, _VAGUE, on=EMF_CONTRADICTS | GROWS_WITH_ANGLE),
    Signature(DRIFT, _VAGUE, on=EMF_CONTRADICTS | GROWS_WITH_TIME),
    Signature(IMPLAUSIBLE, _VAGUE, on=EMF_CONTRADICTS),
    Signature(WHEEL, _VAGUE, on=PARITY_ALARM | RATE_CONTRADICTS),
    Signature(PINION, _VAGUE, on=PARITY_ALARM | EMF_CONSISTENT | RATE_CONSISTENT),
    Signature(ANGLES, _NOTHING, on=PARITY_ALARM | LASTING),
)

#: Alarm whose level is reported with a fault.
ALARM_OF = {
    OFFSET: JUMP,
    DRIFT: PARITY,
    STUCK: JUMP,
    SCALE: PARITY,
    NOISE: RESTLESS,
    INTERMITTENT: JUMP,
    IMPLAUSIBLE: PARITY,
    WHEEL: RATE,
    PINION: PARITY,
    ANGLES: PARITY,
    CURRENT: SURPRISE,
    VOLTAGE: SURPRISE,
    ELECTRIC: SURPRISE,
}


def _row(x: Signature) -> tuple[int, int, int, int]:
    """Return a signature as numbers; faults that it replaces are bits from NONE on."""
    return x.fault, sum(1 << (fault - NONE) for fault in x.replaces), x.on, x.off


#: The tables as kernels read them: rows of fault, replaces, on, off; alarm by fault.
_TABLE = np.array([_row(x) for x in SIGNATURES], np.int64)
_ALARM_OF = np.array([ALARM_OF[fault] for fault in range(PAIRING)], np.int64)


class Const(Record):
    """Constants: ``hold``: frames without a symptom after which a fault is gone."""

    hold: i8


class State(Record):
    """State: ``found``: the fault, NONE without; ``quiet``: frames since the last symptom of it."""

    found: i8
    quiet: i8


def prepare(s: State, c: Const, p: Params) -> None:
    """Fill state and constants.

    Args:
        s: record of State.
        c: record of Const.
        p: parameters of the monitor.
    """
    s.found = NONE
    c.hold = p.frames(1000.0)


@kernel
def lookup(on: int, found: int) -> int:
    """Return the fault whose signature a set of symptoms has, NONE if there is none.

    Args:
        on: symptoms that are on.
        found: the fault that stands, NONE without.
    """
    for k in range(_TABLE.shape[0]):
        fault, replaces, must, must_not = _TABLE[k, 0], _TABLE[k, 1], _TABLE[k, 2], _TABLE[k, 3]
        open_to = (replaces >> (found - NONE)) & 1 == 1
        if open_to and (on & must) == must and (on & must_not) == 0:
            return int(fault)
    return NONE


@kernel
def alarm_of(fault: int) -> int:
    """Return the alarm whose level is reported with a fault."""
    return int(_ALARM_OF[fault])


@kernel
def needs_gear(fault: int) -> bool:
    """Tell whether a fault is found, and found to be gone, by comparing the gear's angles."""
    return bool(fault != NONE and (_ALARM_OF[fault] == PARITY or _ALARM_OF[fault] == RATE))


@kernel
def decide(s: State, c: Const, y: symptoms.State, on: int) -> None:
    """Take the symptoms of one pair of motor frames; sets ``s.found``.

    Args:
        s: record of State.
        c: record of Const.
        y: what the symptoms come from.
        on: symptoms that are on.
    """
    if on & REPEATS or symptoms.any_alarm(y):
        s.quiet = 0
    elif y.geared == 1 or not needs_gear(s.found):
        s.quiet += 1
    if s.found != NONE and s.quiet >= c.hold:
        s.found = NONE
    fault = lookup(on, s.found)
    if fault != NONE:
        s.found = fault


@kernel
def angle_fault(found: int) -> bool:
    """Tell whether a fault is one of an angle."""
    return bool(found != NONE and found < CURRENT)


@kernel
def motor_angle_fault(found: int) -> bool:
    """Tell whether a fault is one of the motor's angle sensor."""
    return bool(OFFSET <= found <= IMPLAUSIBLE)
