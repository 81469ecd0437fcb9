"""From what was seen to the lines of a configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import ID_MASK
from gateway.signals.database import Database
from gateway.signals.decode import of_a_tester
from gateway_fleet.learn import limits
from gateway_fleet.learn.answers import NOTHING, absent_lines, answer_lines, answer_notes
from gateway_fleet.learn.database_match import strangers
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.findings import findings
from gateway_fleet.learn.gaps import cycle_ns, shows_loss
from gateway_fleet.learn.lateral_limits import grip_lines
from gateway_fleet.learn.lines import HEALTH, Learned, Line
from gateway_fleet.learn.observe import Observation, Seen
from gateway_fleet.learn.protections import ProtectionFound, joined, protection_found
from gateway_fleet.learn.ranges import Shown, is_careful
from gateway_fleet.learn.rules import rule_lines
from gateway_fleet.learn.stuck_detection import drives, motion
from gateway_fleet.learn.tails import FALSE_PER_HOUR, Rate
from gateway_fleet.learn.unknown import with_counter, with_signals

#: Frames that must have come of a message for anything to be said of it.
LEAST_FRAMES = 4
#: Frames of two senders: gaps vary by more than this share, and two of them together by less than that of one's.
VARY, TOGETHER = 0.2, 0.2


def derive(
    observation: Observation,
    databases: Sequence[Database],
    asked: Sequence[BusAsked],
    earlier_s: float = 0.0,
    per_hour: float = FALSE_PER_HOUR,
) -> Learned:
    """Return the lines that a configuration gets, and the notes beside them.

    Args:
        observation: of the logs.
        databases: of the buses.
        asked: the buses; those of answers last.
        earlier_s: length of earlier logs whose statistics were added [s].
        per_hour: false codes of all tests that are accepted [1/h].
    """
    learned = Learned()
    found: dict[tuple[int, str], ProtectionFound] = {}
    seconds = earlier_s + sum(log.seconds for log in observation.logs)
    taken: dict[int, set[str]] = {}
    buses = [bus.name for bus in asked if not bus.of_answers]
    _add_health(learned, observation, asked)
    everything = observation
    heard = {key: seen for key, seen in observation.seen.items() if not asked[key[0]].of_answers}
    observation = replace(observation, seen=heard)
    described: dict[tuple[int, str], str] = {}
    for key, seen in observation.seen.items():
        bus, name = key
        file = Path() if seen.unknown else databases[bus].file_of(name)
        cycle = cycle_ns(seen.gaps)
        times = [(stamps - stamps[0]) / cycle for stamps in seen.samples.stamps] if cycle > 0.0 else None
        whole = seen.frames >= LEAST_FRAMES
        described[key] = _described(seen, times) if seen.unknown else ""
        found[key] = protection_found(seen.message, file, seen.samples.runs, whole=whole, cycles=times)
    learned.findings = findings(observation, found, buses)
    makers = [_makers(found, bus) for bus in range(len(asked))]
    show = [shows_loss(seen.gaps for (at, _), seen in observation.seen.items() if at == k) for k in range(len(asked))]
    for key, seen in observation.seen.items():
        bus, name = key
        found[key] = found[key].among(makers[bus])
        several = senders(seen)
        line = limits.check_line(buses[bus], seen, found[key], described[key], shown=show[bus])
        if found[key].claim is None and found[key].rules:
            learned.notes.append(f"{buses[bus]}.{name}: {limits.rivals_text(found[key])}")
        if several and "counter" not in line.keys and found[key].counter is None:
            learned.notes.append(f"{buses[bus]}.{name}: its gaps look as if two senders sent it")
        if not seen.unknown or set(line.keys) - {"message", "length"} or line.keys.get("length") is not False:
            learned.add(line)
    speeds = [drives(observation, bus) for bus in range(len(buses))]
    learned.moving = motion(observation, buses, speeds)
    shown = [_shown(everything, index, per_hour) for index in range(len(asked))]
    for key, seen in observation.seen.items():
        bus, names = key[0], taken.setdefault(key[0], set())
        learned.add(*limits.signal_lines(buses[bus], seen, found[key], seconds, names, shown[bus], speeds[bus]))
    learned.add(*rule_lines(observation, found, buses, shown[0]))
    learned.add(*grip_lines(observation, buses, speeds))
    learned.notes[:0] = strangers(observation, buses)
    learned.notes += limits.notes_of(observation, buses, learned)
    _add_answers(learned, everything, asked, seconds, shown)
    for bus_asked in asked:
        absent_lines(learned, bus_asked)
    learned.notes += answer_notes(everything, asked)
    return learned


def _add_health(learned: Learned, observation: Observation, asked: Sequence[BusAsked]) -> None:
    """Add the health of each bus for which a person gives none."""
    for bus, bus_asked in enumerate(asked):
        if bus_asked.of_answers or "health" in bus_asked.keys:
            continue
        known = {can_id & ID_MASK for at, can_id in observation.foreign if at == bus and not of_a_tester(can_id)}
        keys = {"sleeps": True, "unknown": "tell", "known": sorted(known)}
        why = "it falls asleep, as any car's; identifiers that never came are told"
        learned.add(Line(bus_asked.name, HEALTH, HEALTH, keys, why))


def _add_answers(
    learned: Learned, everything: Observation, asked: Sequence[BusAsked], seconds: float, shown: Sequence[Shown]
) -> None:
    """Add what is asked of answers of ECUs."""
    for index, bus in enumerate(asked):
        mine = {key: seen for key, seen in everything.seen.items() if key[0] == index and bus.of_answers}
        taken: set[str] = set()
        for seen in mine.values():
            answer_lines(learned, bus, seen, seconds, taken, shown[index])
        if mine:
            found = dict.fromkeys(mine, NOTHING)
            learned.add(*rule_lines(replace(everything, seen=mine), found, {index: bus.name}, shown[index]))


def _shown(observation: Observation, bus: int, per_hour: float) -> Shown:
    """Return what the drives show of the signals of a bus; all tests of the configuration share the rate."""
    everything = [
        (index, signal, course)
        for (index, _), seen in observation.seen.items()
        for signal, course in zip(seen.signals, seen.courses.each, strict=True)
    ]
    tests = sum(not course.states for _, _, course in everything)
    careful = is_careful((signal, course) for index, signal, course in everything if index == bus)
    snapshots = observation.snapshots
    return Shown(snapshots.matrix(), snapshots.step_s, Rate(per_hour, tests), careful)


def _makers(found: Mapping[tuple[int, str], ProtectionFound], bus: int) -> set[str]:
    """Return the carmakers' rules that messages of a bus have, and no other rule beside."""
    alone = [each.rules[0] for (at, _), each in found.items() if at == bus and len(each.rules) == 1]
    return {claim.maker for kind in alone for claim in kind} - {""}


def _described(seen: Seen, cycles: Sequence[NDArray[np.float64]] | None) -> str:
    """Give a message of an identifier that no database has its length and what counts in it; returns what is told."""
    if not seen.message.signals:
        seen.message = with_signals(seen.message, max(seen.lengths, key=lambda each: seen.lengths[each]), [])
    seen.message, doubt = with_counter(seen.message, *joined(seen.message.length, seen.samples.runs, cycles))
    return f"in no database{'; ' * bool(doubt)}{doubt}"


def senders(seen: Seen) -> bool:
    """Return whether frames look as if two senders sent them, each at its own times.

    Gaps vary, but those of every second frame do not.
    """
    for stamps in seen.samples.stamps:
        if len(stamps) < 40:
            continue
        one = np.diff(stamps).astype(np.float64)
        two = (stamps[2:] - stamps[:-2]).astype(np.float64)
        if one.std() > VARY * one.mean() and two.std() < TOGETHER * one.std():
            return True
    return False
