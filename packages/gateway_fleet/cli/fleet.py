"""``gateway fleet``: many logs through the monitors, and two such runs compared."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gateway.cli.present import find_config, print_json, say, table_of, wide_console
from gateway.cli.progress import LogsDone
from gateway.common.extras import need
from gateway_fdi.errors import InputError
from gateway_fleet.fleet.answer import CAUSE, LOG, Answer, answer, clock
from gateway_fleet.fleet.report import write_csv, write_report
from gateway_fleet.fleet.task import Outcome
from gateway_fleet.fleet.verdicts import Verdicts
from gateway_logs.corpus import find

#: Findings that a terminal gets; a report has all.
MOST_FINDINGS = 30


def _reporter(*, as_json: bool) -> Callable[[Outcome, int], None]:
    """Return what tells how far a run is: an event a log, or a line."""
    done = LogsDone(goes_on=True)

    def report(outcome: Outcome, left: int) -> None:
        if as_json:
            print_json({"event": "judged", **_event(outcome), "left": left})
        else:
            done(left, outcome.frames)

    return report


def _event(outcome: Outcome) -> dict[str, Any]:
    return {
        "log": outcome.log,
        "path": str(outcome.recording.path),
        "device": outcome.recording.device,
        "state": outcome.state,
        "frames": outcome.frames,
        "dtcs": outcome.dtcs,
        "seconds": outcome.seconds,
    }


def fleet_run(
    logs: Sequence[str],
    config: Path | None,
    out: Path,
    *,
    scheduler: str | None,
    workers: int | None,
    memory: str,
    maps: Sequence[str],
    device: str | None,
    retry: bool,
    dashboard: int | None,
    json: bool,
) -> int:
    """Judge the logs that have no verdict yet; returns the exit code."""
    need("fleet", "runs over a fleet's logs")
    need("parquet", "tables of verdicts")
    if memory not in ("fresh", "carried"):
        raise InputError("the memories are fresh and carried", key="--memory", value=memory)
    if scheduler is not None and workers is not None:
        raise InputError("a scheduler has workers of its own", key="--workers", value=workers)
    from gateway_fleet.fleet.run import FAILED, Order, run  # noqa: PLC0415
    from gateway_replay.pool import default_workers  # noqa: PLC0415 - behind need()

    order = Order(
        find(logs, device),
        find_config(config),
        out,
        tuple(maps),
        carried=memory == "carried",
        scheduler=scheduler,
        workers=default_workers() if workers is None else workers,
        retry=retry,
        dashboard=dashboard,
    )
    begun = time.monotonic()
    result = run(order, _reporter(as_json=json))
    states = Counter(outcome.state for outcome in result.outcomes)
    failed = sum(states[state] for state in FAILED)
    summary = {
        "event": "fleet",
        "logs": len(order.recordings),
        "known": result.known,
        "judged": len(result.outcomes),
        "states": dict(sorted(states.items())),
        "dtcs": sum(outcome.dtcs for outcome in result.outcomes),
        "seconds": time.monotonic() - begun,
        "out": str(out),
    }
    if json:
        print_json(summary)
    else:
        told = ", ".join(f"{count} {state}" for state, count in sorted(states.items())) or "nothing new"
        print(f"{len(order.recordings)} logs, {result.known} judged before; now: {told}. Tables: {out}")
        _print(answer(Verdicts(out)), out)
    return 2 if failed else 0


def _print(found: Answer, out: Path) -> None:
    """Print which cars have what, and the way on."""
    print(found.verdict() + (":" if found.findings else "."))
    if not found.findings:
        return
    table = table_of("car", "finding", "since (UTC)", "DTCs", "log")
    for one in found.findings[:MOST_FINDINGS]:
        text = one.text if one.kind in (CAUSE, LOG) else f"{one.kind}: {one.text}"
        more = f" and {one.logs - 1} more" if one.logs > 1 else ""
        table.add_row(one.device, text, clock(one.since_ns), str(len(one.dtcs) or ""), f"{_short(one.log)}{more}")
    wide_console().print(table)
    if len(found.findings) > MOST_FINDINGS:
        print(f"and {len(found.findings) - MOST_FINDINGS} more")
    print(f"Next: gateway fleet report {out} --html fleet.html")


def _short(path: str) -> str:
    """Return a path from here, if it is below."""
    return os.path.relpath(path) if Path(path).is_relative_to(Path.cwd()) else path


def fleet_report(folder: Path, *, html: Path | None, csv: Path | None, json: bool) -> int:
    """Tell and write what the tables of a run say; returns the exit code."""
    need("parquet", "tables of verdicts")
    found = answer(Verdicts(folder))
    if csv is not None:
        write_csv(csv, found)
    if html is not None:
        write_report(html, found, folder)
    if json:
        print_json({"event": "fleet_report", "verdict": found.verdict(), "findings": [x.row() for x in found.findings]})
    elif csv is None and html is None:
        _print(found, folder)
    else:
        say(f"{' and '.join(str(file) for file in (html, csv) if file is not None)}: {found.verdict()}")
    return 0


def fleet_diff(first: Path, second: Path, *, json: bool) -> int:
    """Compare two runs; returns the exit code: 1 if a verdict differs."""
    need("parquet", "tables of verdicts")
    from gateway_fleet.fleet.diff import diff  # noqa: PLC0415 - behind need()

    found = diff(first, second)
    if json:
        print_json({"event": "diff", **asdict(found)})
        return 1 if found.changed else 0
    if found.changed:
        table = table_of("log", "device", "at [s]", "first", "second", "DTCs gone", "DTCs new")
        for one in found.changed:
            at = "" if one.at_s is None else f"{one.at_s:.3f}"
            events = [_event_text(event) for event in (one.before, one.after)]
            if one.states[0] != one.states[1]:
                events = [f"{state}; {event}" for state, event in zip(one.states, events, strict=True)]
            table.add_row(_short(one.path), one.device, at, *events, ", ".join(one.gone), ", ".join(one.new))
        wide_console().print(table)
    for label, paths in (("first", found.only_first), ("second", found.only_second)):
        if paths:
            more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
            say(f"only in the {label}: {', '.join(paths[:3])}{more}")
    print(f"{len(found.changed)} logs changed their verdict, {found.same} did not")
    return 1 if found.changed else 0


def _event_text(event: dict[str, Any] | None) -> str:
    return "nothing" if event is None else f"{event['dtc']} {event['fault']} 0x{event['status']:02X}"
