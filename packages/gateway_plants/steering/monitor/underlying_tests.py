"""Tests behind the faults: the table of signatures names one part; where two are wrong, each test has its own say."""

from __future__ import annotations

from math import isnan, nan
from typing import Any

from gateway.monitors.contract import Behind, Blame
from gateway_plants.steering.monitor.faults import ANGLE_PARTS, ELECTRIC_PARTS, MOTOR_PART, WHEEL_PART
from gateway_plants.steering.monitor.params import Params
from gateway_plants.steering.monitor.symptoms import ANGLE, BALANCE, PARITY, RATE, SURPRISE

#: How likely a test fails by a part that it is there for; the EMF says nothing of a motor's angle at rest, nor of one
#: that jumps to and fro. Currents and voltages are what it is made of.
_SHOWS, _SOMETIMES, _UPSETS = 0.8, 0.5, 0.3


def _tests(_: Params) -> dict[str, list[Blame]]:
    """Return whom each test blames."""
    angles = [one._replace(share=_SHOWS) for one in ANGLE_PARTS]
    electric = [one._replace(share=_SHOWS) for one in ELECTRIC_PARTS]
    return {
        "gear": angles,
        "rate": [WHEEL_PART],
        "emf": [MOTOR_PART._replace(share=_SOMETIMES), *(one._replace(share=_UPSETS) for one in electric)],
        "voltages": [*electric, MOTOR_PART._replace(share=_SOMETIMES)],
    }


def _levels(p: Params, s: Any) -> list[float]:
    """Return the levels of the tests; the steering wheel's rate forgets, so that it says nothing where it is quiet."""
    limits = p.thresholds.at(p.period_ms)
    y, m = s["symptoms"], s["electrics"]

    def of(alarm: int) -> float:
        return float(y["rules"][alarm]["level"]) / limits[alarm]

    rate = of(RATE)
    return [
        of(PARITY) if y["geared"] else nan,
        rate if rate >= 1.0 else nan,
        of(ANGLE) if m["strict"] and not isnan(m["angle"]) else nan,
        max(of(BALANCE), of(SURPRISE)),
    ]


BEHIND = Behind(_tests, _levels)
