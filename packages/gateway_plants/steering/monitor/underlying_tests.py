"""Tests behind the faults: the table of signatures names one part; where two are wrong, each test has its own say."""

from __future__ import annotations

from math import isfinite, nan, radians
from typing import Any

from gateway.monitors.contract import Behind, Blame
from gateway_plants.steering.monitor.faults import (
    ANGLE_PARTS,
    ELECTRIC_PARTS,
    INTERMITTENT,
    MOTOR_PART,
    NOISE,
    PINION_PART,
    STUCK,
    WHEEL_PART,
)
from gateway_plants.steering.monitor.params import Params
from gateway_plants.steering.monitor.symptoms import ANGLE, BALANCE, PARITY, RATE, SURPRISE

#: How likely a test fails by a part that it is there for; the EMF says nothing of a motor's angle at rest, nor of one
#: that jumps to and fro. Currents and voltages are what it is made of.
_SHOWS, _SOMETIMES, _UPSETS = 0.8, 0.5, 0.3
#: Faults of a motor's angle beside which EMF and gear show errors of other times.
_FLEETING = (STUCK, NOISE, INTERMITTENT)


def _tests(_: Params) -> dict[str, list[Blame]]:
    """Return whom each test blames."""
    angles = [one._replace(share=_SHOWS) for one in ANGLE_PARTS]
    electric = [one._replace(share=_SHOWS) for one in ELECTRIC_PARTS]
    return {
        "gear": angles,
        "rate": [WHEEL_PART],
        "gear by rate": [one for one in angles if one.part != WHEEL_PART.part],
        "emf against gear": [PINION_PART._replace(share=_SHOWS), *electric],
        "emf": [MOTOR_PART._replace(share=_SOMETIMES), *(one._replace(share=_UPSETS) for one in electric)],
        "voltages": [*electric, MOTOR_PART._replace(share=_SOMETIMES)],
    }


def _levels(p: Params, s: Any) -> list[float]:
    """Return the levels of the tests.

    The steering wheel's rate forgets, so that it says nothing where it is quiet. With its integral instead of the
    wheel's angle, the gear says whether one of the other two angles is off beside the wheel's; where the EMF shows
    another error, it is not the motor's alone.
    """
    limits = p.thresholds.at(p.period_ms)
    y, m, k = s["symptoms"], s["electrics"], s["kinematics"]

    def of(alarm: int) -> float:
        return float(y["rules"][alarm]["level"]) / limits[alarm]

    others = abs(float(k["others"])) / limits[RATE] if y["geared"] and k["watched"] else 0.0
    angle = float(m["angle"]) if m["strict"] else nan
    expected = [radians(float(k[name]) * p.motor_ratio) for name in ("others", "others_last")]
    lasts = int(s["found"]) not in _FLEETING and y["jump"]["left"] == 0
    clear = lasts and others >= 1.0 and abs(expected[0]) > limits[ANGLE]
    apart = clear and all(abs(angle - one) > 0.5 * max(abs(angle), abs(one)) for one in expected)
    fails = [level if level >= 1.0 else nan for level in (of(RATE), others, 2.0 if apart else nan)]
    emf = of(ANGLE) if isfinite(angle) else nan
    return [of(PARITY) if y["geared"] else nan, *fails, emf, max(of(BALANCE), of(SURPRISE))]


BEHIND = Behind(_tests, _levels)
