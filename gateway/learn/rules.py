"""Relations between signals as lines of the monitor `rule`."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from cantools.database.can.signal import Signal

from gateway.learn.claims import called_checksum
from gateway.learn.counters import called_counter
from gateway.learn.lines import RULE, Line, inline, short, shown
from gateway.learn.observe import Observation, Seen
from gateway.learn.protections import ProtectionFound
from gateway.learn.relations import Relation, relations

#: Largest deviation seen -> tolerance, at least this share of the largest value: logs seldom show tight turns, slip.
WIDER, LEAST = 2.0, 0.15


def rule_lines(
    observation: Observation, found: dict[tuple[int, str], ProtectionFound], buses: Sequence[str]
) -> list[Line]:
    """Return the relations between the signals of all buses, each with its evidence."""
    names: dict[int, tuple[Seen, Signal]] = {}
    allowed = [False] * observation.snapshots.width
    for key, seen in observation.seen.items():
        own = _of_protection(found[key])
        for k, signal in enumerate(seen.signals):
            column = seen.columns.start + k
            names[column] = seen, signal
            named = called_counter(signal.name) or called_checksum(signal.name)
            allowed[column] = not (named or signal.name in own or signal.is_multiplexer or seen.courses.each[k].states)
    lines: dict[str, Line] = {}
    for relation in relations(observation.snapshots.matrix(), allowed):
        line = _line(relation, names, buses)
        lines[line.name] = line
    return list(lines.values())


def _of_protection(found: ProtectionFound) -> set[str]:
    own = {found.counter.signal} if found.counter is not None else set()
    return own | (set() if found.claim is None else {str(part.get("signal")) for part in found.claim.keys.values()})


def _line(relation: Relation, names: dict[int, tuple[Seen, Signal]], buses: Sequence[str]) -> Line:
    seen, signal = names[relation.of]

    columns = (relation.of, *relation.by)
    units = {names[column][1].unit or "" for column in columns} - {""}

    def called(column: int) -> str:
        other, its = names[column]
        bus = "" if len(buses) == 1 else f"{buses[other.bus]}."
        text = f"{bus}{other.message.name}.{its.name}"
        return f"number({text})" if len(units) > 1 else text

    of, *by = (called(column) for column in columns)
    right = by[0] if len(by) == 1 else f"({by[0]} - {by[1]})"
    slope, offset = short(relation.slope), short(relation.offset)
    text = f"{of} == " + (right if slope == 1.0 else f"{inline(slope)} * {right}")
    # What rounding the numbers adds at the ends of what was seen is part of the deviation.
    course = seen.courses.each[relation.of - seen.columns.start]
    high = max(abs(course.lowest), abs(course.highest))
    rounding = 1e-3 * high
    if abs(offset) > max(rounding, 0.1 * relation.worst):
        text += f" {'-' if offset < 0 else '+'} {inline(abs(offset))}"
    else:
        rounding += abs(offset)
    step = 0.0 if signal.is_float else abs(signal.scale)
    tolerance = _up(max(WIDER * relation.worst + rounding + step, LEAST * high))
    others = "_".join(names[column][1].name for column in relation.by)
    name = re.sub(r"[^A-Za-z0-9_-]", "_", f"{seen.message.name}_{signal.name}_by_{others}")
    why = f"at most {shown(relation.worst)} off at {relation.rows} times, movements agree to {relation.movement:.3f}"
    return Line(buses[seen.bus], RULE, name, {"name": name, "holds": text, "tolerance": tolerance}, why)


def _up(value: float) -> float:
    """Round up to two digits."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.6g}")
