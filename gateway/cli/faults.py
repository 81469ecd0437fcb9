"""``gateway faults``: read and clear a fault memory."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.table import Table

from gateway.cli.present import find_config, print_json, status_text
from gateway.config import load_config
from gateway.faults import service


def _path(config: Path | None, memory: Path | None) -> Path:
    return memory if memory is not None else load_config(find_config(config)).memory.path


def _time(t_ns: int | None) -> str:
    if t_ns is None:
        return "-"
    if t_ns < 10**17:  # a simulation's clock, not the calendar's
        return f"{t_ns / 1e9:.4f} s"
    return datetime.fromtimestamp(t_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]


def list_faults(config: Path | None, *, memory: Path | None, json: bool) -> int:
    """List the entries; returns the exit code."""
    entries = service.list_entries(_path(config, memory))
    if json:
        print_json(entries)
        return 0
    table = Table("DTC", "fault", "status", "occurrence", "first", "last", "frames", box=None)
    for entry in entries:
        table.add_row(
            entry["dtc"],
            entry["fault"],
            f"0x{entry['status']:02X} {'confirmed' if entry['confirmed'] else ''}",
            str(entry["occurrence"]),
            _time(entry["first_ns"]),
            _time(entry["last_ns"]),
            str(len(entry["freeze_frames"])),
        )
    # Off a terminal nothing is cut to 80 columns.
    console = Console() if sys.stdout.isatty() else Console(width=160)
    console.print(table if entries else "no DTCs")
    return 0


def show_fault(dtc: str, config: Path | None, *, memory: Path | None, json: bool) -> int:
    """Show one entry; returns the exit code."""
    entry = service.show(_path(config, memory), dtc)
    if json:
        print_json(entry)
        return 0
    print(f"{entry['dtc']}  {entry['fault']}")
    print(f"status      0x{entry['status']:02X}: {status_text(entry['status'])}")
    print(f"occurrence  {entry['occurrence']}")
    print(f"first, last {_time(entry['first_ns'])}, {_time(entry['last_ns'])}")
    print("evidence of the latest failure")
    for name, value in entry["evidence"].items():
        print(f"  {name:20} {'-' if value is None else format(value, '.6g')}")
    for frame in entry["freeze_frames"]:
        which = "first" if frame["record"] == 1 else "latest"
        print(f"freeze frame {frame['record']} ({which} failure), {_time(frame['t_ns'])}")
        for name, value in frame["signals"].items():
            print(f"  {name:40} {'-' if value is None else format(value, '.6g')}")
    return 0


def clear_faults(dtc: str | None, config: Path | None, *, memory: Path | None, json: bool) -> int:
    """Clear one entry or all; returns the exit code."""
    count = service.clear(_path(config, memory), dtc)
    if json:
        print_json({"cleared": count})
    else:
        print(f"{count} cleared")
    return 0
