"""``gateway fleet ask``, ``learn``, ``page``: what a fleet's tables say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.cli.present import print_json, say, table_of, wide_console
from gateway.common.extras import need
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from gateway_fleet.live.answers import Answers
    from gateway_fleet.live.pool import Pooled

#: Ends of tests' ids whose limits a campaign may set.
_ENDS = ("low", "high", "gradient")


def _answers(folder: Path) -> Answers:
    need("fleet", "tables of a fleet")
    from gateway_fleet.live.answers import Answers  # noqa: PLC0415 - of an extra

    return Answers(folder)


def fleet_ask(folder: Path, what: str, of: str, *, by: Sequence[str], json: bool) -> int:
    """Answer a question; returns the exit code. Arguments as the command has them."""
    answers = _answers(folder)
    if what == "rates":
        rows = answers.rates(by or ("model", "software", "week"))
    elif what == "cars":
        rows = answers.cars(of)
    elif what == "car":
        if not of:
            raise InputError("the id of a car", key="OF")
        rows = answers.history(of)
    else:
        raise InputError("there are rates, cars, car", key="WHAT", value=what)
    if json:
        for row in rows:
            print_json(
                {name: value if isinstance(value, int | float | list) else _text(value) for name, value in row.items()}
            )
        return 0
    if not rows:
        print("nothing of it in the tables")
        return 0
    table = table_of(*rows[0])
    for row in rows:
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else _text(value) or "" for value in row.values()))
    wide_console().print(table)
    return 0


def _text(value: Any) -> str | None:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return None if value is None else str(value)


def fleet_learn(
    folder: Path,
    out: Path,
    *,
    fleet: str,
    name: str,
    serial: int,
    days: float,
    model: str,
    software: str,
    condition: str,
    false_per_hour: float,
    json: bool,
) -> int:
    """Make limits of many cars; returns the exit code. Arguments as the command has them."""
    answers = _answers(folder)
    from gateway_fleet.learn.tails import Rate  # noqa: PLC0415 - of this command only
    from gateway_fleet.live.campaign import Campaign  # noqa: PLC0415
    from gateway_fleet.live.signed_documents import to_toml  # noqa: PLC0415

    if out.exists():
        raise InputError("the file is there already", file=out)
    like = {"model": model.replace("*", "%"), "software": software.replace("*", "%"), "condition": condition}
    tests = answers.tests()
    rate = Rate(false_per_hour, max(len(tests), 1))
    found = answers.pooled(1.0 / rate.hours, **like)
    limits, table = list[dict[str, Any]](), table_of("test", "limit", "cars", "hours", "false in 1e5 h", "interval")
    for fault, (sign, pooled, cars) in sorted(found.items()):
        if pooled is not None and fault.rpartition(".")[2] in _ENDS:
            limits += _limits(fault, sign, pooled, cars)
        _print(table, fault, sign, pooled, as_json=json)
    if not json:
        wide_console().print(table)
    if not limits:
        raise InputError("no test has a limit of many cars: ten cars with twenty minutes each are wanted", file=folder)
    rates = answers.control()
    campaign = Campaign.model_validate({
        "fleet": fleet, "name": name, "serial": serial, "until": datetime.now(UTC) + timedelta(days=days),
        "model": model, "software": software, "limit": limits, "control_per_hour": rates,
    })  # fmt: skip
    out.write_text(to_toml(campaign.model_dump()), encoding="utf-8")
    say(f"{out}: limits of {len(limits)} tests; look at it, then gateway fleet sign")
    return 0


def _limits(fault: str, sign: int, pooled: Pooled, cars: Sequence[str]) -> list[dict[str, Any]]:
    """Return the limits of a test as a campaign has them: one for all, or one for each car."""
    if not pooled.own:
        return [{"test": fault, "limit": sign * float(f"{pooled.limit:.6g}")}]
    of = [(car, value) for car, value in zip(cars, pooled.each, strict=True) if math.isfinite(value)]
    return [{"test": fault, "limit": sign * float(f"{value:.6g}"), "car": car} for car, value in of]


def _print(table: Any, fault: str, sign: int, pooled: Pooled | None, *, as_json: bool) -> None:
    if as_json:
        told = None if pooled is None else {
            "limit": None if pooled.own else sign * pooled.limit, "cars": pooled.cars, "blocks": pooled.blocks,
            "per_hour": pooled.per_hour[0], "low": pooled.per_hour[1], "high": pooled.per_hour[2],
        }  # fmt: skip
        print_json({"test": fault, "pooled": told})
    elif pooled is None:
        table.add_row(fault, "too few cars", "", "", "", "")
    else:
        limit = f"{sign * pooled.limit:.5g}" if not pooled.own else f"own centre + {pooled.limit:.3g} spreads"
        rates = [1e5 * one for one in pooled.per_hour]
        hours = f"{pooled.blocks / 60.0:.0f}"
        table.add_row(fault, limit, str(pooled.cars), hours, f"{rates[0]:.2g}", f"{rates[1]:.2g} to {rates[2]:.2g}")


def fleet_page(folder: Path, out: Path) -> int:
    """Write a page of a fleet; returns the exit code."""
    answers = _answers(folder)
    from gateway_fleet.live.page import write_page  # noqa: PLC0415 - of this command only

    write_page(answers, out)
    say(f"{out}: the fleet of {folder}")
    return 0
