"""The cars of a fleet as each other's reference: a value that lies far from those of all other cars is unusual.

A test of a car has a lowest and a highest value. Each is held against those of the other cars, of each the one that
lies furthest out; of eight others the furthest is left out, so that two cars with the same fault do not hide each
other. How far beyond the others a healthy car may lie is reckoned for values with an exponential tail: of n values the
range is H(n-1) of its scales (harmonic number), and one more lies k ranges beyond them with the probability
exp(-k H(n-1)) / (n + 1). k is what all values of a fleet together reach in one of :data:`FLEETS` healthy fleets.

It is no test of its own, and sets no DTC: cars that are used otherwise are unusual, too. Checks of messages have no
say: when frames come is the recorder's as well.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

#: Other cars that make a reference; healthy fleets of which one has an unusual car by chance.
LEAST_OTHERS, FLEETS = 5, 20
#: Least spread of the others, as a share of the way from their middle to the limit, or of the middle.
_LEAST_SPREAD = 0.02


@dataclass(frozen=True)
class Unusual:
    """A value of a car that is unusual.

    Attributes:
        device: the car.
        fault: the test.
        tested: name and unit of the value; "": the test does not say.
        value: the car's.
        low, high: of the other cars'.
        cars: how many others.
        far: how far beyond them, in parts of what is unusual (1).
        log: in which it was.
        at_ns: when the test came nearest to its limit in this log [ns]; None: it does not say.
    """

    device: str
    fault: str
    tested: str
    value: float
    low: float
    high: float
    cars: int
    far: float
    log: str
    at_ns: int | None


@dataclass(frozen=True)
class _Value:
    value: float
    row: Mapping[str, Any]


def _harmonic(count: int) -> float:
    return sum(1.0 / k for k in range(1, count + 1))


def _furthest(rows: Iterable[Mapping[str, Any]], side: str) -> dict[str, _Value]:
    """Return each car's value that lies furthest out at a side ("low", "high")."""
    found: dict[str, _Value] = {}
    sign = -1.0 if side == "low" else 1.0
    for row in rows:
        if row[side] is None:
            continue
        mine, before = float(row[side]), found.get(row["device"])
        if before is None or sign * mine > sign * before.value:
            found[row["device"]] = _Value(mine, row)
    return found


def unusual(tests: Iterable[Mapping[str, Any]]) -> list[Unusual]:
    """Return what is unusual, the furthest first; of a car's values that are the same one, one.

    Args:
        tests: rows of the table ``tests``.
    """
    by_fault = defaultdict[str, list[Mapping[str, Any]]](list)
    for row in tests:
        if row.get("monitor"):
            by_fault[row["fault"]].append(row)
    sides = [
        (fault, side, cars)
        for fault, rows in by_fault.items()
        for side in ("low", "high")
        if len(cars := _furthest(rows, side)) > LEAST_OTHERS
    ]
    asked = sum(len(cars) for _, _, cars in sides)
    found = dict[tuple[str, float, float, float], Unusual]()
    for fault, side, cars in sides:
        for device in cars:
            one = _beyond(fault, side, cars, device, asked)
            if one is not None:
                key = (device, one.value, one.low, one.high)  # too low and too high are two tests of one value
                found[key] = max(found.get(key, one), one, key=lambda each: (each.fault.endswith(side), each.far))
    return sorted(found.values(), key=lambda one: (-one.far, one.device, one.fault))


def _beyond(fault: str, side: str, cars: Mapping[str, _Value], device: str, asked: int) -> Unusual | None:
    mine, sign = cars[device], -1.0 if side == "low" else 1.0
    others = sorted((sign * one.value for name, one in cars.items() if name != device), reverse=True)
    left_out = int(len(others) >= 8)
    kept = others[left_out:]
    middle, limit = kept[len(kept) // 2], mine.row["limit"]
    reach = abs(middle) if limit is None else abs(sign * float(limit) - middle)
    spread = max(kept[0] - kept[-1], _LEAST_SPREAD * reach)
    scales = _harmonic(len(others) - 1) - left_out
    ranges = math.log(FLEETS * asked * (1 + left_out) / (len(others) + 1)) / scales
    if spread <= 0.0 or sign * mine.value - kept[0] <= ranges * spread:
        return None
    low, high = sorted((sign * kept[0], sign * kept[-1]))
    return Unusual(
        device,
        fault,
        str(mine.row.get("tested") or ""),
        mine.value,
        low,
        high,
        len(others),
        (sign * mine.value - kept[0]) / (ranges * spread),
        str(mine.row["log"]),
        mine.row["worst_t"],
    )
