"""``gateway watch``: view of a running gateway, in a terminal."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.cli.present import find_config, print_json, socket_of
from gateway.config.load import load_config
from gateway.faults.explanation import HELD
from gateway.faults.fault_groups import MOST_NAMED, Case, briefly_named, cases_of
from gateway.faults.status import Status
from gateway.faults.summary import MOST_CASES, folded
from gateway.host.process import call_at_end
from gateway_fdi.errors import GatewayError

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    from gateway_serve.hub import Hub

#: Pace of the screen, and how long a gateway's state is waited for where it is shown once [s].
DRAW_S, PATIENCE_S = 0.25, 5.0
#: Tests that are shown, and characters of a bar, of which two thirds are up to the limit.
NEAREST, WIDTH = 14, 30


def watch(config_path: Path | None, *, status: Path | None, once: bool, json: bool) -> int:
    """Show until a signal comes, or once; returns the exit code."""
    place = status or socket_of(load_config(find_config(config_path)))
    return asyncio.run(_watch(place, once=once or json or not sys.stdout.isatty(), json=json))


async def _watch(place: Path, *, once: bool, json: bool) -> int:
    from gateway_serve.hub import Hub  # noqa: PLC0415 - few want it

    hub = Hub(place)
    work = asyncio.create_task(hub.run())
    try:
        if once:
            return await _show_once(hub, json=json)
        await _show(hub)
    finally:
        work.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await work
    return 0


async def _show_once(hub: Hub, *, json: bool) -> int:
    from gateway_serve.hub import NOT_YET  # noqa: PLC0415 - few want it
    from gateway_serve.link import absence  # noqa: PLC0415

    for _ in range(round(PATIENCE_S / 0.1)):
        await asyncio.sleep(0.1)
        if hub.connected and hub.buses and hub.latest:
            break
        if not hub.connected and hub.reason != NOT_YET:
            break
    if not hub.connected:
        raise GatewayError(absence(hub.reason))
    if json:
        print_json(as_json(hub))
    else:
        from rich.console import Console  # noqa: PLC0415 - slow to load

        Console().print(drawn(hub))
    return 0


async def _show(hub: Hub) -> None:
    from rich.live import Live  # noqa: PLC0415 - slow to load

    ended = asyncio.Event()
    call_at_end(asyncio.get_running_loop(), ended.set)
    with Live(drawn(hub), auto_refresh=False, screen=True) as live:
        while not ended.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(ended.wait(), DRAW_S)
            live.update(drawn(hub), refresh=True)


def as_json(hub: Hub) -> dict[str, Any]:
    """Return what is shown, for programs."""
    faults = hub.hello["faults"]
    return {
        "name": hub.hello["name"],
        "connected": hub.connected,
        "ended": hub.hello.get("ended", ""),
        "monitoring": hub.monitoring,
        "causes": hub.memory["cases"],
        "dtcs": hub.memory["entries"],
        "nearest": [
            {"fault": faults[row["fault"]]["id"], **{k: row.get(k) for k in ("value", "threshold", "ratio", "fdc")}}
            for row in nearest(hub)
        ],
        "buses": hub.buses,
    }


def nearest(hub: Hub) -> list[dict[str, Any]]:
    """Return the latest of each test, the nearest to a fault first."""
    return sorted(hub.latest.values(), key=lambda row: (-row["ratio"], row["fault"]))


def drawn(hub: Hub) -> Group:
    """Return what is shown, for people."""
    from rich.console import Group  # noqa: PLC0415 - slow to load

    return Group(_head(hub), _dtcs(hub), _nearest(hub), _buses(hub))


def _head(hub: Hub) -> Text:
    from rich.text import Text  # noqa: PLC0415 - slow to load

    cases = [case for case in cases_of(hub.memory["entries"]) if case.failing]
    line = Text(f"{hub.hello['name'] or 'gateway'}  ", style="bold")
    if not hub.connected:
        line.append(f"not reached: {hub.reason}", style="bold red")
    elif cases:
        more = f"; {len(cases) - MOST_CASES} more" if len(cases) > MOST_CASES else ""
        line.append(f"{len(cases)} now: " + "; ".join(map(_briefly, cases[:MOST_CASES])) + more, style="bold red")
    else:
        line.append("no faults now", style="green")
    if hub.connected and hub.hello.get("ended"):  # an older gateway does not say it
        line.append(f"   {hub.hello['ended']}", style="bold yellow")
    cycles = ", ".join(f"{name} {cycle['number']}" for name, cycle in hub.memory["cycles"].items())
    line.append(f"   cycle {cycles or '-'}", style="dim")
    if not hub.monitoring["on"]:
        line.append(f"\nmonitoring is switched off by {', '.join(hub.monitoring['by'])}", style="bold red")
    if hub.memory["error"]:
        line.append(f"\n{hub.memory['error']}", style="yellow")
    return line


def _table(title: str, *columns: str) -> Table:
    from rich.table import Table  # noqa: PLC0415 - slow to load

    made = Table(*columns, title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    made.columns[0].no_wrap = True
    return made


def _briefly(case: Case) -> str:
    """Return a case for the first line: its cause if that is proven, else the DTCs that fail."""
    if case.proven:
        return briefly_named(case.components)
    codes = [entry["dtc"] for entry in case.entries if entry["status"] & Status.TEST_FAILED]
    return ", ".join(codes[:MOST_NAMED]) + (f" and {len(codes) - MOST_NAMED} more" if len(codes) > MOST_NAMED else "")


def _dtcs(hub: Hub) -> Group:
    from rich.console import Group  # noqa: PLC0415 - slow to load
    from rich.text import Text  # noqa: PLC0415 - slow to load

    fdc = {hub.hello["faults"][k]["id"]: row.get("fdc", 0) for k, row in hub.latest.items()}
    cases = cases_of(hub.memory["entries"])
    parts: list[Text | Table] = [Text("\nCauses and trouble codes", style="bold")]
    if not cases:
        parts.append(Text("none"))
    ecus = {fault["monitor"]: fault.get("ecu", "") for fault in hub.hello["faults"]}
    for case in cases[:MOST_CASES]:
        if case.text:
            parts.append(Text(case.text, style=("bold red" if case.failing else "yellow") if case.proven else "yellow"))
        kinds = [kind for kind in folded(case.entries, ecus) if len(kind.faults) > MOST_NAMED]
        alike = {fault for kind in kinds for fault in kind.faults} - {case.entries[0]["fault"]}
        parts.append(_case([entry for entry in case.entries if entry["fault"] not in alike], case, fdc))
        parts += [Text(f"  in all {kind.text}", style="dim") for kind in kinds]
    if len(cases) > MOST_CASES:
        parts.append(Text(f"{len(cases) - MOST_CASES} more causes and faults (gateway faults list)"))
    return Group(*parts)


def _case(entries: Sequence[Mapping[str, Any]], case: Case, fdc: Mapping[str, int]) -> Table:
    """Return entries of a case; symptoms below the one that stands for it, indented."""
    from rich.table import Table  # noqa: PLC0415 - slow to load

    made = Table(box=None, pad_edge=False, show_header=False)
    for width in (12, None, 7, 4, 4, 9):
        made.add_column(width=width, no_wrap=width is not None, overflow="fold", ratio=None if width else 1)
    made.expand = True
    for k, entry in enumerate(entries):
        failing = entry["status"] & Status.TEST_FAILED
        state = "[bold red]failing[/]" if failing else "[yellow]stored[/]"
        indent = "  " * bool(case.text) + "  " * bool(k and case.proven)
        made.add_row(
            f"{indent}{entry['dtc']}", entry["fault"], "held" if entry.get("hold") == HELD else state,
            f"{fdc.get(entry['fault'], 0):+d}", f"{entry['occurrence']}x", _time(entry["last_ns"]),
            style="dim" if k and case.proven else "",
        )  # fmt: skip
    return made


def _nearest(hub: Hub) -> Table:
    made = _table("\nNearest to a fault (1: the limit)", "test", "", "ratio", "value", "limit")
    for row in nearest(hub)[:NEAREST]:
        near = row["ratio"]
        filled = min(round(near * WIDTH * 2 / 3), WIDTH)
        colour = "red" if near >= 1 else "yellow" if near >= 0.8 else "blue"
        bar = f"[{colour}]{'━' * filled}[/][dim]{'─' * (WIDTH - filled)}[/]"
        number = [f"{row[name]:.5g}" if row[name] is not None else "-" for name in ("value", "threshold")]
        made.add_row(hub.hello["faults"][row["fault"]]["id"], bar, f"{near:.2f}", *number)
    if not hub.latest:
        made.add_row("no test has run")
    return made


def _buses(hub: Hub) -> Table:
    made = _table("\nBuses", "bus", "state", "load", "frames/s", "lost", "errors")
    for bus in hub.buses:
        colour = "green" if bus.get("state") == "open" else "bold red"
        load = "-" if bus["load"] is None else f"{bus['load']:.1%}"
        rate = "-" if bus["frames_per_s"] is None else f"{bus['frames_per_s']:.0f}"
        errors = ", ".join(f"{name} {count}" for name, count in bus["errors"].items()) or "none"
        lost = str(bus.get("overflow", 0))
        state = f"[{colour}]{bus.get('state', '?')}[/], {bus.get('activity', '?')}"
        made.add_row(bus["bus"], state, load, rate, lost, errors)
    return made


def _time(t_ns: int | None) -> str:
    if t_ns is None:
        return "-"
    if t_ns < 10**17:
        return f"{t_ns / 1e9:.3f} s"
    return datetime.fromtimestamp(t_ns / 1e9, UTC).strftime("%H:%M:%S")
