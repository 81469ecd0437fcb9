"""Relations between signals as lines of the monitor `rule`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from cantools.database.can.signal import Signal

from gateway_fleet.learn.claims import called_checksum
from gateway_fleet.learn.counters import called_counter
from gateway_fleet.learn.lines import RULE, Line, inline, short, shown
from gateway_fleet.learn.observe import Observation, Seen
from gateway_fleet.learn.protections import ProtectionFound
from gateway_fleet.learn.ranges import Shown
from gateway_fleet.learn.relations import LASTS_S, LEAST_VALUES, ONE, TIMES, Relation, relations
from gateway_fleet.learn.stuck_detection import UNITS
from gateway_fleet.learn.tails import Rate

#: Index of a bus -> its name.
Buses = Mapping[int, str] | Sequence[str]
#: Limit that lasting deviations exceed once in hundreds of hours -> tolerance: with this share of the largest value:
#: tyres wear, a car is loaded, logs seldom show tight turns and slip.
WIDER, SHARE = 1.2, 0.06
#: Where no factor alone takes one to the other, it is the share of the span. There, and where the drive was narrow, it
#: is known to hold only where the others are as they were seen, and the signal itself not farther off than this number
#: of its spans.
SHARE_OF_SPAN, FARTHEST = 0.12, 1.0
#: A law with a product is true for small angles, and for slow movements: it gets more.
SHARE_PRODUCT = 0.2
#: Outside of values seen the tolerance grows by this share of the distance, and this number of the slope's standard
#: errors.
GROWTH, ERRORS = 0.15, 4.0
#: A range that begins this near to nothing has no lower end.
NEAR_NOTHING = 0.05
#: Time that a relation must not hold [ms]; one between speeds: a wheel spins, or is braked to a stop, that long on ice.
FAILED_MS, SLIP_MS = 1000.0, 2500.0


def rule_lines(
    observation: Observation, found: dict[tuple[int, str], ProtectionFound], buses: Buses, drive: Shown
) -> list[Line]:
    """Return the relations between the signals of all buses, each with its evidence."""
    units = [""] * observation.snapshots.width
    names: dict[int, tuple[Seen, Signal]] = {}
    allowed = [False] * observation.snapshots.width
    for key, seen in observation.seen.items():
        own = _of_protection(found[key])
        for k, signal in enumerate(seen.signals):
            column = seen.columns.start + k
            names[column], units[column] = (seen, signal), signal.unit or ""
            named = called_counter(signal.name) or called_checksum(signal.name)
            course = seen.courses.each[k]
            quantity = not course.states or (not signal.choices and len(course.values) >= LEAST_VALUES)
            allowed[column] = quantity and not (named or signal.name in own or signal.is_multiplexer)
    lines: dict[str, Line] = {}
    every = np.maximum(np.rint(observation.snapshots.every_s() / drive.step_s), 1.0).astype(np.int64).tolist()
    for relation in relations(drive.matrix, allowed, drive.step_s, drive.rate, units, every):
        line = _line(relation, names, buses, drive.rate)
        lines[line.name] = line
    return list(lines.values())


def _of_protection(found: ProtectionFound) -> set[str]:
    own = {found.counter.signal} if found.counter is not None else set()
    return own | (set() if found.claim is None else {str(part.get("signal")) for part in found.claim.keys.values()})


def _line(relation: Relation, names: dict[int, tuple[Seen, Signal]], buses: Buses, rate: Rate) -> Line:
    seen, signal = names[relation.of]

    columns = (relation.of, *relation.by)
    units = {names[column][1].unit or "" for column in columns} - {""}

    def called(column: int) -> str:
        other, its = names[column]
        bus = "" if len(buses) == 1 else f"{buses[other.bus]}."
        text = f"{bus}{other.message.name}.{its.name}"
        return f"number({text})" if len(units) > 1 else text

    of, *by = (called(column) for column in columns)
    if relation.delay_s > 0.0:
        by = [f"delay({each}, {inline(round(1e3 * relation.delay_s))})" for each in by]
    elif relation.delay_s < 0.0:
        of = f"delay({of}, {inline(round(-1e3 * relation.delay_s))})"
    right = _together(relation, by)
    slips = {unit.lower() for unit in units} <= UNITS.keys() and bool(units)
    slope, offset = short(relation.slope), short(relation.offset)
    side = right if slope == 1.0 else f"{inline(slope)} * {right}"
    # The error by rounding the numbers, at the ends of the values seen, is part of the deviation.
    course = seen.courses.each[relation.of - seen.columns.start]
    high = max(abs(course.lowest), abs(course.highest))
    rounding = 1e-3 * high
    if abs(offset) > max(rounding, 0.1 * relation.limit):
        side += f" {'-' if offset < 0 else '+'} {inline(abs(offset))}"
    else:
        rounding += abs(offset)
    step = 0.0 if signal.is_float else abs(signal.scale)
    local = abs(relation.offset) > 0.1 * high
    share = (SHARE_PRODUCT if relation.form == TIMES else SHARE) * high
    tolerance = _up(
        WIDER * relation.limit + (min(share, SHARE_OF_SPAN * course.span) if local else share) + rounding + step
    )
    text = f"abs({of} - {_in_sum(side)}) <= {_growth(relation, right)}"
    others = "_".join(names[column][1].name for column in relation.by)
    name = re.sub(r"[^A-Za-z0-9_-]", "_", f"{seen.message.name}_{signal.name}_by_{others}")
    why = (
        f"{relation.rows} times, slope to {relation.slope_error:.2g}, for {LASTS_S:g} s at most {shown(relation.limit)}"
        f" off once in {shown(rate.hours)} h, {shown(relation.worst)} at once;"
        f" movements agree to {relation.movement:.3f}"
    )
    keys = {"name": name, "holds": text, "tolerance": tolerance, "failed_ms": SLIP_MS if slips else FAILED_MS}
    near = local or course.narrow
    if near or relation.strict:
        room = FARTHEST * course.span
        own = [(of, (course.lowest - room, course.highest + room))] if near else []
        keys["when"] = _when([*zip(by, relation.within, strict=True), *own])
    return Line(buses[seen.bus], RULE, name, keys, why)


def _together(relation: Relation, by: Sequence[str]) -> str:
    """Return the right side's signals as they go together."""
    if relation.form == ONE:
        return by[0]
    if relation.form == TIMES:
        return f"({by[0]} * {by[1]})"
    often = short(abs(relation.second))
    return f"({by[0]} {'-' if relation.second < 0 else '+'} {by[1] if often == 1.0 else f'{inline(often)} * {by[1]}'})"


def _when(within: Sequence[tuple[str, tuple[float, float]]]) -> str:
    """Return where a relation is known to hold: where signals are as they were seen."""
    parts = []
    for name, (least, most) in within:
        room = 0.02 * (most - least)
        number = name if name.startswith("number(") else f"number({name})"
        parts += [f"{number} >= {inline(short(least - room))}", f"{number} <= {inline(short(most + room))}"]
    return " and ".join(parts)


def _in_sum(side: str) -> str:
    """Return a right side as it stands after a minus."""
    return f"({side})" if re.search(r" [-+] [^()]*$", side) else side


def _growth(relation: Relation, right: str) -> str:
    """Return by what the tolerance grows where the right side's signals leave what was seen of them."""
    least, most = relation.seen
    room = most - least
    share = short(GROWTH * abs(relation.slope) + ERRORS * relation.slope_error, 2)
    plain = f"number({right})"
    above = f"{plain} - {inline(short(most, 3))}"
    if 0.0 <= least <= NEAR_NOTHING * room:
        return f"{inline(share)} * max({above}, 0)"
    return f"{inline(share)} * max(max({inline(short(least, 3))} - {plain}, {above}), 0)"


def _up(value: float) -> float:
    """Round up to two digits."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.6g}")
