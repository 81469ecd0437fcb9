"""What the steering supplies to the isolation (:mod:`gateway_fdi.isolation`): its signature table.

Signature of a single fault, by residual:

    component             increment   EMF's angle   parity (1)   own rate   balance, NIS
    motor angle sensor        x            x            x            -           -
    steering wheel angle      -            -            x            x           -
    pinion angle              -            -            x            -           -
    currents, voltages        -            -            -            -           x

:data:`SIGNATURES` is this table with the ways in which the motor's sensor fails, in the binary symptoms of
:mod:`gateway_plants.steering.monitor.symptoms`.

At rest the EMF is silent: a parity that grows there belongs to one of three angles, and is reported so; the next
motion tells which. The sensors are in a closed loop: the motor follows a wrong angle, and the pinion tells of it.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from gateway_fdi.isolation import machine, table
from gateway_fdi.isolation.table import NOTHING, OPEN
from gateway_fdi.jit import f8s, i8, i8s, kernel, means
from gateway_fdi.masks import BITS
from gateway_plants.steering.monitor import symptoms
from gateway_plants.steering.monitor.faults import (
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
from gateway_plants.steering.monitor.params import Params
from gateway_plants.steering.monitor.symptoms import (
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
NONE = NOTHING

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


#: Alarm by fault, as kernels read it.
_ALARM_OF = np.array([ALARM_OF[fault] for fault in range(PAIRING)], np.int64)
#: One test, that any symptom is there; rows of the table as its faults, by symptoms instead of tests.
_LENGTHS = {"tests": 1, "faults": len(SIGNATURES), "groups": 1, "words": 1}
_SYMPTOMS = (1 << BITS) - 1


class Const(machine.Const, lengths=_LENGTHS):
    """Constants."""

    fault: Annotated[i8s, "faults"] = means("of each row of the table")
    replaces: Annotated[i8s, "faults"] = means("faults whose place it may take, as bits from NONE on")
    frame_ns: i8 = means("between two pairs of motor frames", "ns")


class State(machine.State, lengths=_LENGTHS):
    """State; ``found``: the fault, NONE without."""

    on: Annotated[i8s, "words"] = means("symptoms that are on, a mask")
    level: Annotated[f8s, "tests"] = means("not used: no symptom is on its way")


def prepare(s: State, c: Const, p: Params) -> None:
    """Fill state and constants.

    Args:
        p: parameters of the monitor.
    """
    c.frame_ns = round(p.period_ms * 1e6)
    machine.prepare(s, c, confirm_ns=0, hold_ns=p.frames(1000.0) * c.frame_ns)
    c.tests, c.faults, c.groups = 1, len(SIGNATURES), PAIRING
    for k, row in enumerate(SIGNATURES):
        c.must[k, 0], c.may[k, 0] = row.on, _SYMPTOMS & ~row.off
        c.fault[k], c.replaces[k] = row.fault, sum(1 << (fault - NONE) for fault in row.replaces)


@kernel
def lookup(s: State, c: Const) -> int:
    """Return the fault that the symptoms are of and that may take the place of the one that stands, or OPEN."""
    for k in range(c.faults):
        if c.replaces[k] >> (s.found - NONE) & 1 == 1 and table.fits(c, k, s.on):
            return int(c.fault[k])
    return OPEN


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
        y: what the symptoms come from.
        on: symptoms that are on.
    """
    s.on[0] = on
    said = lookup(s, c)
    s.up[0] = 1 if on & REPEATS or symptoms.any_alarm(y) or said != OPEN else 0
    tells = y.geared == 1 or not needs_gear(s.found)
    machine.stand(s, c, c.frame_ns, c.frame_ns if tells else 0)
    machine.decide(s, c, s.level, said, said != OPEN)


@kernel
def quiet(s: State) -> bool:
    """Return whether the last pair had no symptom."""
    return bool(s.up[0] == 0)


@kernel
def angle_fault(found: int) -> bool:
    """Tell whether a fault is one of an angle."""
    return bool(found != NONE and found < CURRENT)


@kernel
def motor_angle_fault(found: int) -> bool:
    """Tell whether a fault is one of the motor's angle sensor."""
    return bool(OFFSET <= found <= IMPLAUSIBLE)
