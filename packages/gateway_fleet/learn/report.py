"""Report of learning, for people: a page in Markdown, and the same as data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from gateway_fleet.learn.figures import by_kind
from gateway_fleet.learn.learn import Asked, Result
from gateway_fleet.learn.lines import CHECK, RULE, SIGNAL, inline, shown
from gateway_fleet.learn.novelty import in_words, per_minute
from gateway_fleet.learn.observers import OBSERVERS
from gateway_fleet.learn.trial import Outcome, Smallest


def summary(result: Result) -> dict[str, Any]:
    """Return the numbers of what was learned."""
    lines = result.learned.lines.values()
    checks = [line for line in lines if line.table == CHECK]
    protected = {"crc", "checksum", "e2e"}
    return {
        "frames": sum(log.frames for log in result.observation.logs),
        "seconds": round(sum(log.seconds for log in result.observation.logs), 3),
        "messages": len(checks),
        "timeouts": sum("timeout_ms" in line.keys for line in checks),
        "counters": sum("counter" in line.keys or "e2e" in line.keys for line in checks),
        "checksums": sum(bool(protected & set(line.keys)) for line in checks),
        "signals": sum(line.table == SIGNAL for line in lines),
        "relations": sum(line.table == RULE for line in lines),
        "held_out_s": round(result.held_s, 3),
        "held_out_frames": result.held_frames,
        "alarms": list(result.alarms),
        "conditions": list(result.conditions),
        "widened": result.changes,
        "faults_tried": len(result.outcomes),
        "faults_named": sum(outcome.named for outcome in result.outcomes),
        "everyday": by_kind(result.trials.everyday),
        "new_per_minute": per_minute(result.observation.snapshots),
        "kept": result.kept,
        "dropped": result.dropped,
    } | observed(result)


def observed(result: Result) -> dict[str, list[str]]:
    """Return what other packages saw: topic -> one line for each message."""
    found: dict[str, list[str]] = {kind.topic: [] for kind in OBSERVERS.values()}
    for (_, name), seen in result.observation.seen.items():
        for observer in seen.observers:
            found[observer.topic].append(f"{name}: {observer.told()}")
    return found


def data(result: Result) -> dict[str, Any]:
    """Return all of it, for programs."""
    return summary(result) | {
        "lines": [
            {"bus": line.bus, "table": line.table, "name": line.name, "keys": dict(line.keys), "why": line.why}
            for line in result.learned.lines.values()
        ],
        "notes": result.learned.notes,
        "findings": result.learned.findings,
        "faults": [
            {
                "kind": outcome.trial.injection.kind,
                "message": outcome.trial.message,
                "signal": outcome.trial.injection.signal,
                "value": outcome.trial.injection.value,
                "by": outcome.by,
                "after_s": None if not outcome.named else round(outcome.after_s, 3),
                "frames": outcome.frames,
                "named": outcome.named,
                "others": list(outcome.others),
            }
            for outcome in result.outcomes
        ],
        "everyday_faults": [asdict(each) for each in result.trials.everyday],
        "smallest": [asdict(each) for each in result.trials.seeing],
        "unwatched": result.trials.unwatched,
    }


def markdown(asked: Asked, result: Result) -> str:
    """Return the page."""
    found = summary(result)
    parts = [
        f"# Learned: {asked.name}",
        f"From {found['frames']} frames, {found['seconds']:.0f} s of {len(asked.logs)} log(s);"
        f" {found['held_out_frames']} frames, {found['held_out_s']:.0f} s were held out.",
        f"{found['messages']} messages: {found['timeouts']} timeouts, {found['counters']} counters,"
        f" {found['checksums']} checksums. {found['signals']} signals with limits, {found['relations']} relations.",
        f"{in_words(found['new_per_minute']).capitalize()}.",
        _silence(result),
        f"The logs themselves: {', '.join(result.conditions)}." if result.conditions else "",
        *_list("Faults that the logs may have: learn from others", result.learned.findings),
        *(f"{line}." for lines in observed(result).values() for line in lines),
        *_faults(result),
        *_lines(result),
        *_list("Not there any more", result.dropped),
        *_list("Not in it", result.learned.notes),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _silence(result: Result) -> str:
    if result.alarms:
        return f"**Healthy frames still set {', '.join(result.alarms)}**: see these lines."
    widened = "".join(f"\n- {change}" for change in result.changes)
    return "Replayed on all frames, those held out too: no fault was set." + (
        f" Widened for it:\n{widened}" if widened else ""
    )


def _faults(result: Result) -> list[str]:
    if not result.outcomes:
        return []
    left = result.trials.left
    of = f"; {left} more signals were not tried" if left else ""
    kinds = sorted({outcome.trial.injection.kind for outcome in result.outcomes})
    head = f"Faults that limits are there for, named of those put into what was held out{of}."
    head += " An offset is as large as the signal's own spread, not as its limits."
    table = ["| message | " + " | ".join(kinds) + " |", "|---" * (len(kinds) + 1) + "|"]
    for message in sorted({outcome.trial.message for outcome in result.outcomes}):
        mine = [outcome for outcome in result.outcomes if outcome.trial.message == message]
        table.append(f"| {message} | " + " | ".join(_cell(mine, kind) for kind in kinds) + " |")
    missed = [
        f"{outcome.trial.injection.kind} of {outcome.trial.message}"
        f"{'.' + outcome.trial.injection.signal if outcome.trial.injection.signal else ''}: nothing was set"
        f" ({outcome.frames} frames)"
        for outcome in result.outcomes
        if not outcome.named
    ]
    parts = [
        *_everyday(result),
        "## Faults put in",
        head,
        "\n".join(table),
        *_list("Not named", missed, level=3),
        *_smallest(result),
    ]
    return [
        *parts,
        *_list("Not watched", [", ".join(result.trials.unwatched)] if result.trials.unwatched else []),
    ]


def _everyday(result: Result) -> list[str]:
    """Return what came of everyday faults, by kind, and which were silent."""
    if not result.trials.everyday:
        return []
    rows = [f"| {kind} | {' | '.join(map(str, counts))} |" for kind, counts in by_kind(result.trials.everyday).items()]
    head = (
        "Put into what was held back, whether or not anything watches for them; `named`: a code that sees the part at"
        " fault.\n\n| fault | tried | found | named | silent |\n|---|---|---|---|---|"
    )
    silent = [f"{one.kind}: {one.about}" for one in result.trials.everyday if not one.codes]
    return ["## Everyday faults", "\n".join([head, *rows]), *_list("Silent", silent, level=3)]


def _smallest(result: Result) -> list[str]:
    """Return the smallest faults of each signal that were seen."""
    rows = []
    for each in result.trials.seeing:
        unit = f" {each.unit}" if each.unit else ""
        cells = [
            each.name,
            f"{shown(each.spread)}{unit}",
            *(_size(size, unit) for size in (each.up, each.down)),
            _size(each.scale, " times"),
            "-" if each.stuck_s is None else f"after {each.stuck_s:.1f} s",
        ]
        rows.append(f"| {' | '.join(cells)} |")
    head = (
        "An offset or a factor of this size was seen at each moment at which it was tried; smaller ones, and those with"
        " a dash, are **not watched**. `at 2 of 4` says that even the largest was not seen at the other moments: there"
        " the signal is not watched.\n\n"
        "| signal | its spread | offset seen, up | offset seen, down | factor seen | standing value seen |\n"
        "|---|---|---|---|---|---|"
    )
    return ["## Smallest faults that are seen", "\n".join([head, *rows])] if rows else []


def _size(smallest: Smallest | None, unit: str) -> str:
    if smallest is None:
        return "-"
    part = "" if smallest.always else f" at {smallest.named} of {smallest.moments}"
    return f"{shown(smallest.size)}{unit}{part}"


def _cell(outcomes: Sequence[Outcome], kind: str) -> str:
    count = Counter(outcome.named for outcome in outcomes if outcome.trial.injection.kind == kind)
    total = count[True] + count[False]
    return f"{count[True]}/{total}" if total else ""


def _lines(result: Result) -> list[str]:
    parts = ["## Limits"]
    for table, title in ((CHECK, "Messages"), (SIGNAL, "Signals"), (RULE, "Relations")):
        lines = [line for line in result.learned.lines.values() if line.table == table]
        if lines:
            rows = [f"| {line.name} | `{inline(_asked(line.keys))}` | {line.why} |" for line in lines]
            parts.append("\n".join([f"| {title} | asked | evidence |", "|---|---|---|", *rows]))
    return parts


def _asked(keys: Any) -> dict[str, Any]:
    return {key: value for key, value in keys.items() if key not in ("message", "signal", "name")}


def _list(title: str, texts: Sequence[str], level: int = 2) -> list[str]:
    return [f"{'#' * level} {title}", "\n".join(f"- {text}" for text in texts)] if texts else []
