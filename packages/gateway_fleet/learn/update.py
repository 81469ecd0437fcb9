"""Another drive added to a configuration that was learned before."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import replace
from pathlib import Path
from typing import Any

from gateway_fdi.errors import InputError
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.limit_relaxation import asks
from gateway_fleet.learn.lines import CAUSE, CHECK, HEALTH, RULE, SIGNAL, Learned, Line, short
from gateway_fleet.learn.merge import File, of_a_person, read
from gateway_fleet.learn.state import Kept, Refused


def read_file(out: Path) -> File:
    """Read the configuration as it is now.

    Raises:
        InputError: it cannot be read, or is not TOML.
    """
    try:
        return read(out.read_text())
    except OSError as error:
        raise InputError(error.strerror or str(error), file=out) from error
    except InputError as error:
        raise error.within(out) from error
    except ValueError as error:
        raise InputError(f"not TOML: {error}", file=out) from error


def add_before(learned: Learned, before: Kept, file: File, buses: tuple[BusAsked, ...]) -> set[tuple[str, str, str]]:
    """Add findings of earlier logs to those of the new ones; returns a person's places, which are taken out.

    Findings of earlier logs for a message that did not come now stay. A relation keeps the wider of its tolerances. A
    protection that was proven before and for which the new logs have too few frames stays.
    """
    kept = {place for place in of_a_person(file, before.written) if place[1] != CAUSE}
    names = {bus.name for bus in buses}
    for place, line in before.written.items():
        if place[0] not in names:
            continue
        new = learned.lines.get(place)
        learned.lines[place] = line if new is None else _joined(line, new)
    _refuse(learned, before.refused)
    _in_order(learned)
    for place in kept:
        learned.lines.pop(place, None)
    return kept


def _refuse(learned: Learned, refused: Set[Refused]) -> None:
    """Take out what earlier logs broke: that the new ones keep it says nothing against them."""
    for place, key in refused:
        line = learned.lines.get(place)
        if line is None or key not in line.keys:
            continue
        keys = {name: value for name, value in line.keys.items() if name != key}
        if asks(line.table, keys):
            learned.lines[place] = replace(line, keys=keys, why=f"{line.why}; no {key}: earlier logs broke it")
        else:
            del learned.lines[place]


def _joined(old: Line, new: Line) -> Line:
    """Return the line of all logs: of the new one, which has counted the old logs in, with what only the old say."""
    keys = dict(new.keys)
    why = new.why
    if new.table == RULE:
        return old if old.keys.get("tolerance", 0.0) >= new.keys.get("tolerance", 0.0) else new
    if new.table == CHECK:
        for name in ("e2e", "crc", "checksum", "counter"):
            other = (
                ("counter", "crc", "checksum")
                if name == "e2e"
                else ("e2e", "crc" if name == "checksum" else "checksum")
            )
            if name in old.keys and name not in keys and not (name != "counter" and set(other) & set(keys)):
                keys[name] = old.keys[name]
                why += f"; {name} of earlier logs"
        if "timeout_ms" in keys and "timeout_ms" in old.keys:
            keys["timeout_ms"] = max(keys["timeout_ms"], old.keys["timeout_ms"])
        if "most" in keys and "most" in old.keys:
            keys["most"] = max(keys["most"], old.keys["most"], key=_often)
        for name in ("length", "value"):
            if isinstance(old.keys.get(name), bool):
                keys[name] = old.keys[name]
    if new.table == HEALTH:
        keys["known"] = sorted({*new.keys["known"], *old.keys["known"]})
    if new.table == SIGNAL:
        _widest(keys, old)
    return Line(new.bus, new.table, new.name, keys, why)


def _often(most: Mapping[str, float]) -> float:
    """Return the rate of a limit [1/ms]."""
    return most["frames"] / most["ms"]


def _widest(keys: dict[str, Any], old: Line) -> None:
    """Keep the wider of two limits: the old one may have been widened since healthy logs broke it."""
    before = old.keys
    for name in ("plausible", "gradient", "stuck", "undefined"):
        if name in keys and name not in before:
            del keys[name]  # it was taken out, or the earlier logs did not carry it
    if "plausible" in keys:
        (low, high), (least, most) = keys["plausible"], before["plausible"]
        keys["plausible"] = [short(min(low, least)), short(max(high, most))]
    if "stuck" in keys:
        ends = {key: value for key, value in keys["stuck"].items() if key == "inside"}
        keys["stuck"] = max(keys["stuck"], before["stuck"], key=_slower) | ends
    if "gradient" in keys:
        keys["gradient"] = max(keys["gradient"], before["gradient"])
    if before.get("invalid") == [] and "invalid" in keys:
        keys["invalid"] = []


def dropped(before: Kept, learned: Learned, kept: Set[tuple[str, str, str]], buses: Set[str]) -> list[str]:
    """Return what earlier logs gave and is not there any more, one line each; a person's places are none of it."""
    said = []
    for place, old in before.written.items():
        if place in kept or place[0] not in buses or place[1] == CAUSE:
            continue
        line = learned.lines.get(place)
        gone = [key for key in old.keys if line is None or key not in line.keys]
        gone = [key for key in gone if key not in _NAMES and old.keys[key] not in (False, [])]
        if gone:
            why = "" if line is None else f" ({line.why})"
            said.append(f"{place[0]}: {place[2]}: {', '.join(gone)} of earlier logs is not there any more{why}")
    return said


#: Keys that say which line it is.
_NAMES = ("message", "signal", "name", "tolerance", "when", "failed_ms")


def _slower(stuck: dict[str, Any]) -> tuple[float, float]:
    """Return what to sort limits of rest by, the one that asks least last."""
    return -stuck.get("share", 0.0), stuck.get("seconds", 0.0)


def _in_order(learned: Learned) -> None:
    """Put the lines in the order of the tables."""
    order = {HEALTH: 0, CHECK: 1, SIGNAL: 2, RULE: 3}
    learned.lines = dict(sorted(learned.lines.items(), key=lambda item: order[item[1].table]))
