"""Limits by the tyres: the faster a car is, the less its steering wheel is turned.

A car that turns its steering wheel by an angle goes through a curve with the lateral acceleration
a = v^2 tan(angle / i) / l, i the ratio of the steering, l the wheelbase. Tyres end it; so angle * v^2 has a bound that
a healthy car keeps on any road. It is a range by condition: wide at walking pace, narrow at speed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from gateway_fleet.learn.lines import RULE, Line, inline, short, shown
from gateway_fleet.learn.observe import Observation
from gateway_fleet.learn.stuck_detection import UNITS, Drives

#: Lateral acceleration [m/s2] and the largest product of steering ratio and wheelbase of cars and vans [m].
GRIP, RATIO_BASE = 8.0, 55.0
#: The bound is at least this multiple of the largest value seen.
WIDER = 2.0
_ANGLE = re.compile(r"STEER\w*(ANGLE|POS)|LENK\w*WINKEL|(ANGLE|SWA)\w*STEER|^SAS_Angle$|^SteeringAngle$", re.IGNORECASE)
#: Other angles, rates, and requests of an assistant.
_OTHER = re.compile(r"RATE|SPEED|REQ|CMD|CMND|TARGET|DESIRED|ZERO|OFFSET|FRACTION|MOTOR", re.IGNORECASE)
#: Farthest that a steering wheel turns to either side [degree]: beyond it the database has another sign or scale.
TURNS = 1080.0
#: Rows that it must have been driven for.
LEAST_ROWS = 200


def grip_lines(observation: Observation, buses: Sequence[str], speeds: Sequence[Sequence[Drives]]) -> list[Line]:
    """Return a rule for each steering wheel angle, each with its evidence."""
    stamps, matrix = observation.snapshots.stamps(), observation.snapshots.matrix()
    lines = []
    for (bus, name), seen in observation.seen.items():
        speed = next((each for each in speeds[bus] if each.unit in UNITS and each.message != name), None)
        if speed is None:
            continue
        fast = speed.at(stamps)
        for k, signal in enumerate(seen.signals):
            unit = (signal.unit or "").lower()
            if (
                unit not in ("deg", "degree", "degrees", "\u00b0")
                or not _ANGLE.search(signal.name)
                or _OTHER.search(signal.name)
            ):
                continue
            turned = np.abs(matrix[:, seen.columns.start + k]) * fast**2
            turned = turned[~np.isnan(turned)]
            bound = np.degrees(GRIP * RATIO_BASE) / UNITS[speed.unit] ** 2
            course = seen.courses.each[k]
            farthest = max(-course.lowest, course.highest)
            if len(turned) < LEAST_ROWS or turned.max() == 0.0 or course.changes == 0 or farthest > TURNS:
                continue
            most = float(turned.max())
            limit = short(max(bound, WIDER * most), 3)
            full = f"{name}.{signal.name}"
            title = re.sub(r"[^A-Za-z0-9_-]", "_", f"{name}_{signal.name}_by_grip")
            text = f"abs(number({full})) * number({speed.name}) ** 2 <= {inline(limit)}"
            why = f"{shown(most)} seen at most, {len(turned)} times; tyres end at {GRIP:g} m/s2"
            lines.append(Line(buses[bus], RULE, title, {"name": title, "holds": text, "failed_ms": 1000.0}, why))
    return lines
