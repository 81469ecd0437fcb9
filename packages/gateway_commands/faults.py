"""``gateway faults``: read and clear a fault memory."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.cli.lines import Lines
from gateway.cli.present import find_config, print_json, say, status_text, table_of, wide_console
from gateway.config.load import load_config
from gateway.faults import service
from gateway.faults.explanation import CAUSE, HELD, OPEN, WAITING
from gateway.faults.fault_groups import MOST_NAMED, cases_of, named, percent
from gateway.faults.lock import is_unsaved
from gateway.faults.remedy import WHEN
from gateway.faults.summary import folded, in_lines, summary_of
from gateway.monitors.evidence import in_words

if TYPE_CHECKING:
    from rich.table import Table

#: Faults that a list has where not all are asked for.
MOST_LISTED = 20
#: Columns from which a list has the descriptions, too.
WIDE = 120


def _path(config: Path | None, memory: Path | None) -> Path:
    return memory if memory is not None else load_config(find_config(config)).memory.path


def _time(t_ns: int | None) -> str:
    if t_ns is None:
        return "-"
    if t_ns < 10**17:  # a simulation's clock, not the calendar's
        return f"{t_ns / 1e9:.4f} s"
    return datetime.fromtimestamp(t_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]


def _second(t_ns: int | None) -> str:
    """Return a stamp without fractions of a second; ``faults show`` has them."""
    return _time(t_ns)[:19] if t_ns is not None and t_ns >= 10**17 else _time(t_ns)


def restarts_in_words(restarts: Mapping[str, Any]) -> str:
    """Return in a line how often a gateway died; "": never."""
    if not restarts["count"]:
        return ""
    row = f", {restarts['in_a_row']} in a row" if restarts["in_a_row"] else ""
    return (
        f"restarts after a death: {restarts['count']}{row}; the last {_second(restarts['t_ns'])}: {restarts['reason']}"
    )


def _say_if_behind(path: Path) -> None:
    if is_unsaved(path):
        say(
            f"{path}: stored: false - the gateway that keeps this memory cannot write it at present;"
            " it knows more than is shown here (its log and events say why)"
        )
    if count := service.waiting(path):
        say(
            f"{path}: {count} verdicts that were told right before the gateway ended suddenly are in its journal only;"
            " they are shown as they were told, without evidence, until its next start takes them in"
        )


def summarize(config: Path | None, *, memory: Path | None, json: bool, every: bool = False) -> int:
    """Print the verdict, the causes and what was not judged; returns the exit code."""
    path = _path(config, memory)
    _say_if_behind(path)
    found = service.summary(path).as_dict()
    if json:
        print_json(found)
        return 0
    lines = Lines()
    lines.print(found["title"], mark=found["title"], colour="bold")
    for line in in_lines(found, _second, every=every):
        lines.print(f"  {line}", hang=6)
    return 0


def list_faults(
    config: Path | None, *, memory: Path | None, json: bool, ecu: str | None = None, every: bool = False
) -> int:
    """List the entries, or the DTCs of another ECU ("all": of all); returns the exit code.

    Of symptoms that are alike the first is listed, and the others are counted, unless ``every`` one is wanted.
    """
    if ecu is not None:
        return _list_ecu_dtcs(ecu, config, memory=memory, json=json)
    path = _path(config, memory)
    entries = service.list_entries(path)
    _say_if_behind(path)
    if json:
        print_json(entries)
        return 0
    console, lines = wide_console(), Lines()
    wide = console.width >= WIDE
    if entries:
        print(summary_of(entries).title)
    console.print(_entries((), wide=wide, titles=True) if entries else "no DTCs")
    for case in cases_of(entries):
        if case.text:
            print(case.text)
        kinds = [] if every else [kind for kind in folded(case.entries) if len(kind.faults) > MOST_NAMED]
        alike = {fault for kind in kinds for fault in kind.faults} - {case.entries[0]["fault"]}
        shown = [entry for entry in case.entries if entry["fault"] not in alike]
        console.print(_entries(shown, wide=wide, below=bool(case.text), folds=case.proven))
        for kind in kinds:
            lines.print(f"  in all {kind.text}", hang=6)
    if service.overflowed(path):
        print("the memory was full: entries of less important faults gave way")
    if (restarts := service.restarts(path)).get("in_a_row"):
        print(restarts_in_words(restarts))
    return 0


def _list_ecu_dtcs(ecu: str, config: Path | None, *, memory: Path | None, json: bool) -> int:
    """List the DTCs of another ECU, or of all; returns the exit code."""
    path = _path(config, memory)
    known = service.ecu_dtcs(path)
    found = [each for each in known if ecu in ("all", each["ecu"])]
    _say_if_behind(path)
    if json:
        print_json(found)
        return 0
    table = table_of("ECU", "DTC", "status", "state", "came", "first, last", "snapshots")
    for each in found:
        table.add_row(
            each["ecu"], each["dtc"], f"0x{each['status']:02X}", "there" if each["there"] else "went",
            str(each["came"]), f"{_second(each['first_ns'])}\n{_second(each['last_ns'])}",
            "\n".join(line for kind, data in each["snapshots"].items() for line in _of_snapshots(kind, data)),
        )  # fmt: skip
    others = ", ".join(sorted({each["ecu"] for each in known}))
    hint = f"; the ECUs with DTCs are {others}" if others else ""
    wide_console().print(table if found else f"no DTCs of other ECUs{hint}")
    return 0


def _of_snapshots(kind: str, data: str) -> list[str]:
    """Return data of another ECU's DTC: as they came, and the values of snapshots by OBD on UDS."""
    from gateway_ask.answers.snapshots import snapshots_in_words  # noqa: PLC0415 - most lists need no decoder

    return [f"{kind}: {data}", *(snapshots_in_words(bytes.fromhex(data)) if kind == "1904" else [])]


def _entries(
    entries: Sequence[Mapping[str, Any]], *, wide: bool, titles: bool = False, below: bool = False, folds: bool = False
) -> Table:
    """Return entries as lines of a list.

    Args:
        entries: of a case.
        wide: whether there is room for what the faults are.
        titles: whether the columns have titles.
        below: whether they are below a line with what explains them.
        folds: whether all but the first are below that one.
    """
    table = table_of("DTC", "fault", "status", "count", "frames", "first, last")
    table.show_header, table.expand = titles, True
    for column, width in zip(table.columns, (12, None, 14 if wide else 9, 5, 6, 19), strict=True):
        column.width, column.ratio = width, None if width else 1
    for number in (0, 5):
        table.columns[number].no_wrap = True
    for number in (3, 4):
        table.columns[number].justify = "right"
    for k, entry in enumerate(entries):
        table.add_row(
            f"{'  ' * below}{'  ' * bool(k and folds)}{entry['dtc']}",
            entry["fault"] + (f"\n{entry['description']}" if wide and entry["description"] else ""),
            f"0x{entry['status']:02X}{_state(entry)}",
            str(entry["occurrence"]),
            str(len(entry["freeze_frames"])),
            f"{_second(entry['first_ns'])}\n{_second(entry['last_ns'])}",
        )
    return table


def _state(entry: Mapping[str, Any]) -> str:
    return " confirmed" if entry["confirmed"] else f" {entry['hold']}" if entry["hold"] else ""


def _show_cause(path: Path, entry: Mapping[str, Any], *, every: bool) -> None:
    """Print what explains an entry, and the others that it explains."""
    cause = entry["cause"]
    if cause is None:
        return
    if cause["role"] == OPEN:
        first, *others = cause["ranked"]
        print(f"cause       not isolated: {named(first['components'])} {percent(first['probability'])}")
    else:
        first, *others = cause["ranked"]
        print(
            f"cause       {named(first['components'])} ({percent(first['probability'])}), as of {_time(cause['t_ns'])}"
        )
    for one in others:
        print(f"            or {named(one['components'])} {percent(one['probability'])}")
    if cause["role"] == OPEN:
        return
    part = "names the cause" if cause["role"] == CAUSE else "a symptom"
    stands = (
        ", stands for the cause" if cause["lead"] == entry["fault"] else f"; {cause['lead_dtc']} stands for the cause"
    )
    held = {HELD: "; held: not confirmed for that", WAITING: "; its confirmation waits"}.get(entry["hold"], "")
    print(f"its part    {part}{stands}{held}")
    (case,) = [c for c in cases_of(service.list_entries(path)) if any(e["dtc"] == entry["dtc"] for e in c.entries)]
    others = [other for other in case.entries if other["dtc"] != entry["dtc"]]
    if len(others) > MOST_LISTED and not every:
        for kind in folded(others):
            Lines().print(f"  with      {kind.text}", hang=12)
        return
    for other in others:
        print(f"  with      {other['dtc']}  {other['fault']}")


def show_fault(dtc: str, config: Path | None, *, memory: Path | None, json: bool, every: bool = False) -> int:
    """Show one entry, with ``every`` other that its cause explains by itself; returns the exit code."""
    path = _path(config, memory)
    _say_if_behind(path)
    entry = service.show(path, dtc)
    if json:
        print_json(entry)
        return 0
    print(f"{entry['dtc']}  {entry['fault']}")
    _show_cause(path, entry, every=every)
    if entry["description"] is not None:
        print(f"what        {entry['description']}")
        print(f"severity    {entry['severity']}: {WHEN[entry['severity']]}")
        print(f"what to do  {entry['remedy']}")
    print(f"status      0x{entry['status']:02X}: {status_text(entry['status'])}")
    print(f"occurrence  {entry['occurrence']}")
    print(f"first, last {_time(entry['first_ns'])}, {_time(entry['last_ns'])}")
    print("evidence of the latest failure")
    for name, value in entry["evidence"].items():
        label, text = in_words(name, value, "-" if value is None else format(value, ".6g"))
        print(f"  {label:40} {text}")
    if entry["inputs"]:
        print("inputs of its monitor then")
        for name, value in entry["inputs"].items():
            print(f"  {name:40} {'-' if value is None else format(value, '.6g')}")
    print(
        f"cycles      {entry['failed_cycles']} failed in a row, {entry['aged_cycles']} of aging"
        f"{', permanent' if entry['permanent'] else ''}"
    )
    print(f"near misses {entry['near_misses']}, greatest detection counter {entry['peak_fdc']}")
    print(f"recordings  {entry['recordings']}")
    for frame in entry["freeze_frames"]:
        which = {1: "first", 2: "latest"}.get(frame["record"], "an earlier")
        print(f"freeze frame {frame['record']} ({which} failure), {_time(frame['t_ns'])}")
        for name, value in frame["signals"].items():
            print(f"  {name:40} {'-' if value is None else format(value, '.6g')}")
    return 0


def verify(config: Path | None, *, memory: Path | None, json: bool) -> int:
    """Say whether every row is as it was written; returns the exit code."""
    path = _path(config, memory)
    found = service.verify(path)
    _say_if_behind(path)
    if json:
        print_json(found)
        return 0 if found["whole"] else 1
    rows = ", ".join(f"{count} {kind}" for kind, count in found["counted"].items()) or "nothing"
    if found["whole"]:
        print(f"whole: {rows}")
    else:
        first, *more = found["broken"]
        print(f"NOT WHOLE, first: {first['text']}")
        for broken in more:
            print(f"  then: {broken['text']}")
        print(f"whole are: {rows}")
    if found["links"]:
        print(f"last of {found['links']} links: {found['last_link']}, digest {found['digest']}")
    return 0 if found["whole"] else 1


def near_misses(config: Path | None, *, memory: Path | None, json: bool, every: bool = False) -> int:
    """List faults that came near a failure, the first ones or ``every`` one; returns the exit code."""
    found = service.near_misses(_path(config, memory))
    if json:
        print_json(found)
        return 0
    table = table_of("DTC", "fault", "near misses", "greatest detection counter")
    for entry in found if every else found[:MOST_LISTED]:
        table.add_row(entry["dtc"], entry["fault"], str(entry["near_misses"]), str(entry["peak_fdc"]))
    table.columns[0].no_wrap = True
    wide_console().print(table if found else "nothing came near a failure")
    if len(found) > MOST_LISTED and not every:
        print(f"{len(found) - MOST_LISTED} more (--all)")
    return 0


def interventions(config: Path | None, *, memory: Path | None, json: bool) -> int:
    """List what testers did; returns the exit code."""
    found = service.interventions(_path(config, memory))
    if json:
        print_json(found)
        return 0
    table = table_of("latest", "count", "by", "session, level", "what", "request", "outcome")
    for each in found:
        by = each["protocol"] + (f" {each['address']:X} on {each['bus']}" if each["bus"] else "")
        by += f", {each['role']}" if each["role"] else ""
        refused = "done" if each["outcome"] == "done" else f"refused 0x{each['nrc']:02X}"
        table.add_row(
            _time(each["t_ns"]), str(each["count"]), by, f"{each['session']}, {each['security']}", each["action"],
            each["request"], refused,
        )  # fmt: skip
    table.columns[0].no_wrap = True
    wide_console().print(table if found else "no interventions")
    return 0


def recordings(dtc: str, config: Path | None, *, memory: Path | None, folder: Path, json: bool) -> int:
    """Write the frames recorded around a DTC's failures as logs; returns the exit code."""
    found = service.recordings(_path(config, memory), dtc)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for number, recording in enumerate(found, start=1):
        file = folder / f"{dtc.upper()}-{number}.log"
        file.write_bytes(zlib.decompress(recording.log))
        written.append(
            {
                "file": str(file),
                "fault": recording.fault,
                "t_ns": recording.t_ns,
                "frames": recording.frames,
                "dropped": recording.dropped,
            }
        )
    if json:
        print_json(written)
        return 0
    for entry in written:
        lost = f", {entry['dropped']} more were too many" if entry["dropped"] else ""
        print(f"{entry['file']}: {entry['frames']} frames around {_time(entry['t_ns'])}{lost}")  # type: ignore[arg-type]
    if not written:
        print("no frames were recorded around its failures ([memory.recording])")
    return 0


def clear_faults(
    dtc: str | None, config: Path | None, *, memory: Path | None, json: bool, force: bool = False, why: str = ""
) -> int:
    """Clear one entry or all; returns the exit code."""
    count = service.clear(_path(config, memory), dtc, force=force, why=why)
    if json:
        print_json({"cleared": count})
    else:
        print(f"{count} cleared")
    return 0
