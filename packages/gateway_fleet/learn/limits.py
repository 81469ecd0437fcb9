"""From what was seen to limits that a healthy part keeps, each with its evidence.

A log shows what a part does, not all that it may do. So a limit is taken from it only where the log has room to show
that: ranges of signals that went through their span often (:mod:`gateway_fleet.learn.ranges`), gradients with a margin
and only where something steeper could be told, standstill only of long logs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.bus.frames import ID_MASK
from gateway_checks.signal.params import MOST_CODES, MOST_VALUES
from gateway_checks.signal.parts import no_value
from gateway_fleet.learn import gaps
from gateway_fleet.learn.claims import called_checksum
from gateway_fleet.learn.counters import called_counter, signal_of
from gateway_fleet.learn.course import Course
from gateway_fleet.learn.lines import CHECK, SIGNAL, Learned, Line, short, shown
from gateway_fleet.learn.observe import Observation, Seen
from gateway_fleet.learn.protections import ProtectionFound
from gateway_fleet.learn.ranges import LASTS_S, Shown, database_range, range_of, representable, waiting
from gateway_fleet.learn.standards import standard
from gateway_fleet.learn.stuck_detection import Drives, moving
from gateway_fleet.learn.unknown import SHOWN

#: A share of lost frames that is reported.
LOST = 0.005
#: Values that it takes to say anything of a signal.
LEAST_VALUES = 100
#: Steepest change seen -> limit, at least the whole range in this time [s]: a log of gentle driving shows no emergency.
STEEPER, ACROSS_S = 3.0, 1.0
#: A limit must be below this share of the range in one period, or nothing could exceed it.
TOLD = 0.5
#: Standstill is learned of logs of this length [s], of signals that moved this often; the limit is longer by this
#: factor.
LONG_S, MOVES, LONGER, LEAST_REST_S = 600.0, 1000, 10.0, 10.0
#: Usual times between values after which a second one has come, above what the monitor waits for it (its LATE).
TWICE = 1.75
#: A code that stands for no value in healthy logs for longer is no fault [s]. Where nothing else is asked of a signal
#: it is one after this time [ms]: an ECU that has just started has no value yet (1.8 s in a GT350).
HEALTHY_NONE_S, NONE_MS = 0.25, 3000.0
#: Share of the texts of a value table that must have come for others to be a fault, and how many there must be.
TEXTS_SEEN, LEAST_TEXTS = 0.66, 3
#: Or chance would put the values seen among the texts with a probability below this one.
TEXTS_BY_CHANCE = 1e-3


def check_line(bus: str, seen: Seen, found: ProtectionFound, note: str = "", *, shown: bool = True) -> Line:
    """Return what is asked of a message, with its evidence; ``note``: is told beside it; ``shown``: of timeout_ms."""
    message, why = seen.message, [f"{seen.frames} frames", *([note] if note else [])]
    keys: dict[str, Any] = {"message": message.name}
    kind = gaps.sending(seen.gaps)
    timeout = gaps.timeout_ms(seen.gaps, shown=shown)
    if kind != gaps.TOO_FEW:
        why.append(f"{kind}, {_ms(seen.gaps.quantile_ns(0.5))}, longest gap {_ms(seen.gaps.largest_ns)}")
        lost = gaps.lost_share(seen.gaps)
        why += [f"about {100 * lost:.2g} % of its frames lost"] if lost > LOST else []
    if timeout is not None and _ended(seen):
        why.append(f"ended {seen.ended_s:.1f} s before the log: no timeout")
        timeout = None
    elif timeout is None:
        why.append("no timeout" if kind != gaps.TOO_FEW else "too few for a timeout")
    if timeout is not None:
        keys["timeout_ms"] = timeout
        keys |= _wake(seen, timeout, why)
    if (often := gaps.most(seen.gaps, seen.samples.repeated())) is not None:
        keys["most"] = often
        why.append(f"{often['frames']:g} gaps in {_ms(seen.gaps.spans_ns[int(often['frames'])])} at least")
    if any(length < message.length for length in seen.lengths):
        keys["length"] = False
        why.append(
            f"frames of {', '.join(str(n) for n in sorted(seen.lengths))} bytes, the database has {message.length}"
        )
    elif seen.unknown and seen.frames < SHOWN:
        keys["length"] = False
        why.append("too few for a length")
    elif len(seen.lengths) == 1 and seen.frames >= SHOWN:
        keys["length"] = next(iter(seen.lengths))
    if found.claim is not None:
        keys |= found.claim.keys
        name = found.claim.protection.name
        why.append(f"{name} right in {found.claim.matched} of {found.claim.frames}")
        why += [found.claim.note] if found.claim.note else []
    elif found.rules:
        why.append(rivals_text(found))
    if found.counter is not None:
        keys["counter"] = found.counter.keys(signal_of(message, found.counter).length)
        why.append(f"counts in {found.counter.ones} of {found.counter.steps} steps")
        if not found.counter.wraps:
            why.append("not seen to come round")
    for name in found.unexplained:
        why.append(f"{name}: no rule proven in {found.frames} different frames")
    return Line(bus, CHECK, message.name, keys, "; ".join(why))


def rivals_text(found: ProtectionFound) -> str:
    """Return that no checksum is claimed, as its frames fit several rules."""
    names = dict.fromkeys(kind[0].protection.name for kind in found.rules)
    return f"no checksum: its {found.frames} different frames fit {', '.join(names)}"


def _wake(seen: Seen, timeout: float, why: list[str]) -> dict[str, Any]:
    """Return what a message has to come after a wake-up, and add what it stands on."""
    wake = gaps.wake_ms(seen.gaps, timeout)
    if wake is None:
        return {}
    times, latest_ns = seen.gaps.wakes
    why.append(f"came {latest_ns * 1e-9:.3g} s after a wake-up at most, of {times}")
    return {"wake_ms": wake}


def _ms(ns: float) -> str:
    return f"{ns * 1e-6:.3g} ms"


def _ended(seen: Seen) -> bool:
    """Return whether a message stopped before its log did: switched off, with the ignition or otherwise."""
    return seen.ended_s * 1e9 > max(2e9, 3.0 * seen.gaps.largest_ns)


def signal_lines(
    bus: str,
    seen: Seen,
    found: ProtectionFound,
    seconds: float,
    taken: set[str],
    drive: Shown,
    speeds: Sequence[Drives] = (),
) -> list[Line]:
    """Return what is asked of the signals of a message.

    Args:
        bus: name of the bus.
        seen: courses of signals.
        found: how the message is protected: its counter and checksum are no quantities.
        seconds: length of the logs [s].
        taken: names of faults that are in use; those of the lines are added.
        drive: values of all signals, and how often a healthy one may alarm.
        speeds: signals that say how fast the car is.
    """
    own = {found.counter.signal} if found.counter is not None else set()
    if (claim := found.claim or next((kind[0] for kind in found.rules), None)) is not None:
        own |= {str(part.get("signal")) for part in claim.keys.values()}
    lines = []
    counted = found.counter is not None or (found.claim is not None and "e2e" in found.claim.keys)
    checksum = None if counted or found.claim is None else next(iter(own), None)
    moves = {signal.name: (keys, text) for signal, keys, text in moving(seen, own, speeds, drive.rate, checksum)}
    period = seen.gaps.quantile_ns(0.5) * 1e-9 if seen.gaps.count else 0.0
    for k, (signal, course) in enumerate(zip(seen.signals, seen.courses.each, strict=True)):
        keys: dict[str, Any] = {}
        why: list[str] = []
        column = drive.matrix[:, seen.columns.start + k]
        if not (
            signal.name in own or called_checksum(signal.name) or called_counter(signal.name) or signal.is_multiplexer
        ):
            keys, why = _limits(seen.message.name, signal, course, column, drive, (period, seconds))
        if signal.name in moves and "stuck" not in keys:
            keys["stuck"], text = moves[signal.name]
            why.append(text)
        if "stuck" in keys and signal.name != checksum:
            keys["stuck"] = keys["stuck"] | _inside(signal, course, keys["stuck"])
            if np.diff(keys["stuck"].get("inside", (0.0, 1.0))) <= 0.0:
                del keys["stuck"]  # nothing lies between its ends
        if keys:
            name = f"{seen.message.name}.{signal.name}"
            head: dict[str, Any] = {"signal": name}
            if signal.name in taken:
                head["name"] = f"{seen.message.name}_{signal.name}"
            taken.add(str(head.get("name", signal.name)))
            lines.append(Line(bus, SIGNAL, name, head | keys, "; ".join(why)))
    return lines


def _limits(
    message: str, signal: Signal, course: Course, column: NDArray[np.float64], drive: Shown, times: tuple[float, float]
) -> tuple[dict[str, Any], list[str]]:
    why: list[str] = []
    if course.count and not course.states:
        why.append(f"{course.count} values, {shown(course.lowest)} to {shown(course.highest)}")
    keys, text = _range(message, signal, course, column, times[0], drive)
    why += [text] if text else []
    for part in (_gradient, _rest):
        more, text = part(signal, course, *times)
        keys |= more
        why += [text] if text else []
    codes = no_value(signal)
    if 0 < len(codes) <= MOST_CODES and course.none_s > HEALTHY_NONE_S:
        if keys:
            keys["invalid"] = []
        why.append(f"no value for {course.none_s:.3g} s in healthy logs: no fault")
    elif 0 < len(codes) <= MOST_CODES and course.count:
        keys |= {"invalid": "auto"} | ({} if keys else {"failed_ms": NONE_MS})
        why.append(f"{len(codes)} invalid code{'s' * (len(codes) > 1)} in the database, seen {course.none} times")
    more, text = _texts(signal, course)
    return keys | more, why + ([text] if text else [])


def _range(
    message: str, signal: Signal, course: Course, column: NDArray[np.float64], every_s: float, drive: Shown
) -> tuple[dict[str, Any], str]:
    own = standard(message, signal, course.lowest, course.highest)
    found, text = range_of(own, signal, course, column, every_s, drive)
    if found is None:
        return {}, text
    # A limit is of values that come twice: where they come seldom, the test waits for the second, and so it heals.
    late = short(TWICE * 1e3 * every_s, 2) if every_s > LASTS_S else 0.0
    times = {"failed_ms": max(late, 0.0 if own is None else own.failed_ms or 0.0), "passed_ms": late}
    return {"plausible": list(found)} | {name: ms for name, ms in times.items() if ms}, text


def _gradient(signal: Signal, course: Course, period: float, _seconds: float) -> tuple[dict[str, Any], str]:
    if course.states or course.count < LEAST_VALUES or course.steepest <= 0 or period <= 0:
        return {}, ""
    low, high = database_range(signal) or representable(signal)
    if course.lowest < low or course.highest > high:  # the database is wrong
        low, high = representable(signal)
    reach = high - low if np.isfinite(high - low) else 10.0 * course.span
    limit = short(max(STEEPER * course.steepest, reach / ACROSS_S), 3)
    if limit * period > TOLD * reach:
        return {}, ""
    return {"gradient": limit}, f"steepest {shown(course.steepest)}/s"


def _rest(_signal: Signal, course: Course, _period: float, seconds: float) -> tuple[dict[str, Any], str]:
    limit = max(LONGER * course.rest_s, LEAST_REST_S)
    if seconds < LONG_S or course.states or course.changes < MOVES or limit > seconds / 10.0:
        return {}, ""
    return {"stuck": {"seconds": short(limit, 2)}}, f"at rest for {course.rest_s:.3g} s at most"


def _inside(signal: Signal, course: Course, stuck: Mapping[str, Any]) -> dict[str, Any]:
    """Return where a signal must move: not at the ends of what it can say, where a healthy one may stand for long."""
    low, high = representable(signal)
    least, most = database_range(signal) or (low, high)
    if not least <= course.lowest <= course.highest <= most:  # the database is wrong
        least, most = low, high
    half = 0.5 * abs(float(signal.scale))
    own = stuck.get("inside", (-np.inf, np.inf))
    found = max(least + half, own[0]), min(most - half, own[1])
    return {"inside": [float(f"{end:.12g}") for end in found]} if np.isfinite(found).all() else {}


def texts_of(signal: Signal) -> set[float]:
    """Return the physical values that the database has texts for."""
    return {float(raw * signal.scale + signal.offset) for raw in signal.choices or {}}


def _texts(signal: Signal, course: Course) -> tuple[dict[str, Any], str]:
    texts = texts_of(signal)
    if not LEAST_TEXTS <= len(texts) <= MOST_VALUES or not course.values or len(texts) == 1 << signal.length:
        return {}, ""
    seen, shown_share = len(course.values), len(course.values & texts) / len(texts)
    if not course.values <= texts:
        return {}, ""
    room = min(1 << signal.length, 1 << 20)
    chance = float(np.prod([(len(texts) - k) / (room - k) for k in range(seen)]))
    if shown_share < TEXTS_SEEN and chance > TEXTS_BY_CHANCE:
        return {}, ""
    return {"undefined": True}, f"{len(course.values)} of {len(texts)} texts seen, and nothing else"


def notes_of(observation: Observation, buses: Sequence[str], learned: Learned) -> list[str]:
    """Return messages that came and are in no database, and those in one that never came; one line each."""
    notes = []
    for bus, name in enumerate(buses):
        pauses = observation.pauses[bus]
        if pauses.count:
            notes.append(
                f"{name}: {pauses.count} pauses of the bus or the recorder, {pauses.longest_s:.3g} s at most:"
                " no gap of a message"
            )
        absent = sorted(message for index, message in observation.absent if index == bus)
        if absent:
            notes.append(f"{name}: {len(absent)} messages of the database never came: {', '.join(absent)}")
        unknown = [seen for (index, _), seen in observation.seen.items() if index == bus and seen.unknown]
        asked = [seen for seen in unknown if (name, CHECK, seen.message.name) in learned.lines]
        foreign = {can_id & ID_MASK: count for (index, can_id), count in observation.foreign.items() if index == bus}
        foreign |= {seen.message.frame_id: seen.frames for seen in unknown if seen not in asked}
        if foreign:
            ids = ", ".join(f"0x{can_id:X}" for can_id in sorted(foreign))
            notes.append(
                f"{name}: {len(foreign)} identifiers ({sum(foreign.values())} frames) are in no database, and nothing"
                f" is asked of them: {ids}"
            )
        if asked:
            notes.append(
                f"{name}: {len(asked)} identifiers ({sum(seen.frames for seen in asked)} frames) are in no database and"
                f" have messages of their own: {', '.join(sorted(seen.message.name for seen in asked))}"
            )
        untested = _without_a_text(observation, bus, learned.lines, name)
        if untested:
            notes.append(f"{name}: values without a text are not tested, too few texts came: {', '.join(untested)}")
        ranged = {line.name for line in learned.of(name, SIGNAL) if "plausible" in line.keys}
        seconds = sum(log.seconds for log in observation.logs)
        if waits := _waiting(observation, bus, ranged, seconds):
            notes.append(f"{name}: no range after {seconds:.0f} s: {', '.join(waits)}")
        resting = [line.name for line in learned.of(name, SIGNAL) if "inside" in line.keys.get("stuck", {})]
        if resting:
            notes.append(f"{name}: a value that stands at the end of its range is not tested: {', '.join(resting)}")
        notes += [f"{name}: {note}" for index, note in observation.notes if index == bus]
        for (index, message), one in observation.seen.items():
            if index == bus and len(one.sources) > 1:
                exact = ", ".join(f"{message}_0x{one.message.frame_id & ~0xFF | each:X}" for each in one.sources)
                notes.append(f"{name}: {message} comes from several sources, one of them is learned: {exact}")
    return notes


def _waiting(observation: Observation, bus: int, ranged: set[str], seconds: float) -> list[str]:
    """Return the quantities of a bus that the drives have not shown enough of for a limit, and why."""
    return [
        f"{name} ({why})"
        for (index, _), seen in sorted(observation.seen.items())
        for signal, course in zip(seen.signals, seen.courses.each, strict=True)
        if index == bus and (name := f"{seen.message.name}.{signal.name}") not in ranged
        if (why := waiting(signal, course, seconds))
    ]


def _without_a_text(observation: Observation, bus: int, lines: Mapping[Any, Line], name: str) -> list[str]:
    """Return the enumerations of a bus that had values with a text only, and whose others no line asks for."""
    said = []
    for (index, message), seen in observation.seen.items():
        for signal, course in zip(seen.signals, seen.courses.each, strict=True) if index == bus else ():
            texts, line = texts_of(signal), lines.get((name, SIGNAL, f"{message}.{signal.name}"))
            asked = line is not None and line.keys.get("undefined")
            if (
                LEAST_TEXTS <= len(texts) < 1 << signal.length
                and course.values
                and course.values <= texts
                and not asked
            ):
                said.append(f"{message}.{signal.name} ({len(course.values)} of {len(texts)})")
    return sorted(said)
