"""The tables of figures in docs/performance.md, measured here and now, with machine and date.

    python bench                the table of engine.py and that of live.py, printed
    python bench --write        the same, written into docs/performance.md between its two marks

A table is never written by hand: the marks and what they enclose are replaced as a whole.
"""

from __future__ import annotations

import argparse
import datetime
import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "performance.md"
BEGIN, END = "<!-- python bench --write: begin -->", "<!-- python bench --write: end -->"


def rows_of(name: str, *options: str) -> tuple[list[dict], str]:
    """Run a benchmark; returns its rows and the machine."""
    command = [sys.executable, str(ROOT / "bench" / name), "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{name}:\n{done.stderr}")
    found = json.loads(done.stdout)
    return found["rows"], found["machine"]


def processor() -> str:
    """Return the name of the processor as Linux has it."""
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    found = re.search(r"^model name\s*: (.+)$", text, re.MULTILINE)
    return found[1] if found else "unknown processor"


def engine_table(rows: list[dict]) -> list[str]:
    """Return the table of bench/engine.py."""
    lines = ["| one log, one run | frames/s | us a frame | against the loop |", "|---|---:|---:|---:|"]
    for row in rows:
        rate = row["per_second"]
        lines.append(f"| {row['name']} | {rate:,.0f} | {1e6 / rate:.3g} | {row['ratio']:.3g} x |")
    return lines


def live_table(rows: list[dict]) -> list[str]:
    """Return the table of bench/live.py."""
    lines = ["| live, frame to DTC frame | lost | p50 ms | p99 ms |", "|---|---:|---:|---:|"]
    lines += [
        f"| {row['name']} | {row['lost']:,} | {row['p50_ms']:.3g} | {row['p99_ms']:.3g} |"
        for row in rows
        if "p50_ms" in row
    ]
    lines += ["", "| live, without loss | frames/s | against the loop |", "|---|---:|---:|"]
    lines += [
        f"| {row['name'].partition(':')[0]} | {row['per_second']:,} | {row['ratio']:.3g} x |"
        for row in rows
        if "p50_ms" not in row
    ]
    return lines


def replaced(text: str, table: str) -> str:
    """Return a text with another table between the marks.

    Raises:
        SystemExit: the marks are not there, once each and in order.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end or BEGIN in after or END in after:
        sys.exit(f"{PAGE.name}: needs the lines {BEGIN} and {END}, once each")
    return f"{before}{BEGIN}\n{table}\n{END}{after}"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python bench", description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write the tables into docs/performance.md")
    parser.add_argument("--seconds", default="5", help="of each point of live.py")
    options = parser.parse_args()
    engine, machine = rows_of("engine.py")
    live, _ = rows_of("live.py", "--seconds", options.seconds)
    told = f"{processor()}, {machine}; {datetime.datetime.now(tz=datetime.UTC):%Y-%m-%d}:"
    table = "\n".join([told, "", *engine_table(engine), "", *live_table(live)])
    if options.write:
        PAGE.write_text(replaced(PAGE.read_text(), table))
    print(table)


if __name__ == "__main__":
    main()
