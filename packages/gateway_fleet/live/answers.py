"""The usual questions to a fleet's tables, asked by DuckDB: rates of causes, which cars, one car's history, limits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gateway_fdi.errors import InputError
from gateway_fleet.live.pool import CONFIDENCE, Pooled, pool, shown

#: Causes as they come anew: each that a diagnosis of a car has proven, and the one before had not.
_CAME = """
with diagnosed as (
    select car, model, software, limits, t, causes,
        coalesce(lag(causes) over (partition by car order by t, origin, number), []) as before
    from {events} where kind = 'diagnosis'
), came as (
    select car, model, software, limits, t, unnest([c for c in causes if not list_contains(before, c)]) as cause
    from diagnosed
), driven as (
    select car, model, software, limits, t, seconds / 3600 as hours from {events} where seconds is not null
)
"""
_RATES = """{came}
, told as (select {by}, cause, count(*) as times, count(distinct car) as cars from came group by all),
hours as (select {by}, sum(hours) as hours from driven group by all)
select {names}, cause, times, cars, coalesce(hours, 0) as hours
from told left join hours using ({names}) order by times desc, cause, {names}
"""
_BY_LIMITS = """{came}
, told as (select limits, count(*) as times from came group by limits),
hours as (select limits, sum(hours) as hours from driven group by limits)
select coalesce(told.limits, hours.limits) as limits, coalesce(times, 0) as times, coalesce(hours, 0) as hours
from told full join hours using (limits) order by limits
"""
_CARS = """{came}
select cause, car, any_value(model) as model, any_value(software) as software, count(*) as times,
    max(t)::timestamp as last
from came where {cause} group by cause, car order by cause, times desc, car
"""
_HISTORY = """
select t::timestamp as t, kind, limits, fault, dtc, status, causes from {events}
where car = ? and kind <> 'statistics' order by t, origin, number
"""
_TESTS = """
select fault, sign, block_s, car, "values", weights, epoch(t)::bigint // 86400 as day from {tests}
where model like ? and software like ? and condition = ? and sign <> 0 order by fault, car, t
"""


class Answers:
    """A fleet's tables.

    Raises:
        InputError: there are none.
    """

    def __init__(self, folder: Path) -> None:
        if not (folder / "events").is_dir():
            raise InputError("no tables here (made by gateway fleet collect)", file=folder)
        self._tables = {
            name: f"read_parquet('{_quoted(folder / name)}/*/[!.]*.parquet')" for name in ("events", "tests")
        }

    def ask(self, query: str, values: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Return the rows of a query in which {events} and {tests} stand for the tables."""
        import duckdb  # noqa: PLC0415 - slow to load, and an extra

        with duckdb.connect() as db:
            db.execute("set timezone = 'UTC'")
            for name, text in {"came": _CAME, **self._tables}.items():
                query = query.replace("{" + name + "}", text)
            found = db.execute(query, list(values))
            names = [column[0] for column in found.description or ()]
            return [dict(zip(names, row, strict=True)) for row in found.fetchall()]

    def rates(self, by: Sequence[str] = ("model", "software", "week")) -> list[dict[str, Any]]:
        """Return how often each cause was told, by model, software, week or limits: an hour, with its interval.

        Raises:
            InputError: another column.
        """
        known = {
            "model": "model",
            "software": "software",
            "limits": "limits",
            "week": "date_trunc('week', t)::date as week",
        }
        for name in by:
            if name not in known:
                raise InputError(f"by {', '.join(known)}", key="--by", value=name)
        columns = ", ".join(known[name] for name in by)
        rows = self.ask(_RATES.replace("{by}", columns).replace("{names}", ", ".join(by)))
        return [
            row | dict(zip(("per_hour", "low", "high"), rate(row["times"], row["hours"]), strict=True)) for row in rows
        ]

    def cars(self, cause: str = "") -> list[dict[str, Any]]:
        """Return which cars told a cause, or any."""
        return self.ask(_CARS.replace("{cause}", "cause = ?" if cause else "true"), [cause] if cause else [])

    def history(self, car: str) -> list[dict[str, Any]]:
        """Return what a car told, in order."""
        return self.ask(_HISTORY, [car])

    def fleet(self) -> dict[str, Any]:
        """Return how many cars, hours and events there are, and when the last came."""
        (row,) = self.ask(
            "select count(distinct car) as cars, coalesce(sum(seconds), 0) / 3600 as hours, count(*) as events,"
            " max(t)::timestamp as last from {events}"
        )
        return row

    def tests(self) -> list[str]:
        """Return the tests that have statistics."""
        return [row["fault"] for row in self.ask("select distinct fault from {tests} order by fault")]

    def by_limits(self) -> list[tuple[int, int, float]]:
        """Return serial number of the limits that judged, causes told, hours driven."""
        rows = self.ask(_BY_LIMITS)
        return [(int(row["limits"]), int(row["times"]), float(row["hours"])) for row in rows]

    def control(self) -> float:
        """Return how often cars tell a cause by their own limits, a little above where they never did [1/h]."""
        of = [(times, hours) for serial, times, hours in self.by_limits() if serial == 0]
        times, hours = sum(t for t, _ in of), sum(h for _, h in of)
        return min(max(times, 1) / max(hours, 1.0), 1000.0)

    def pooled(
        self, per_hour: float, *, model: str = "%", software: str = "%", condition: str = ""
    ) -> dict[str, tuple[int, Pooled | None, list[str]]]:
        """Return the limit of each test that many cars give: fault -> sign, limit, the cars in their order.

        Args:
            per_hour: false alarms of one test that a car may have in an hour [1/h].
            model: of the cars; ``%``: any.
            software: of the cars; ``%``: any.
            condition: under which.
        """
        of: dict[tuple[str, int, float], dict[str, list[tuple[Any, Any, int]]]] = {}
        for row in self.ask(_TESTS, [model, software, condition]):
            drives = of.setdefault((row["fault"], row["sign"], row["block_s"]), {}).setdefault(row["car"], [])
            drives.append((row["values"], row["weights"], row["day"]))
        found: dict[str, tuple[int, Pooled | None, list[str]]] = {}
        for (fault, sign, block_s), cars in of.items():
            found[fault] = sign, pool([shown(drives) for drives in cars.values()], block_s, per_hour), list(cars)
        return found


def _quoted(path: Path) -> str:
    return str(path.resolve()).replace("'", "''")


def rate(times: int, hours: float) -> tuple[float | None, float | None, float | None]:
    """Return how often something happens in an hour, and the ends of its interval (Poisson, Garwood 1936) [1/h]."""
    from scipy.stats import chi2  # noqa: PLC0415 - slow to load

    if not hours > 0.0:
        return None, None, None
    beyond = (1.0 - CONFIDENCE) / 2.0
    low = float(chi2.ppf(beyond, 2 * times)) / 2.0 if times else 0.0
    return times / hours, low / hours, float(chi2.ppf(1.0 - beyond, 2 * times + 2)) / 2.0 / hours
