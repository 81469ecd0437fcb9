"""``gateway evaluate drives``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from gateway.cli.present import print_json, say, table_of, wide_console
from gateway.cli.progress import LogsDone
from gateway.common.extras import need
from gateway_fleet.study.drives.judge import SENDERS, SHORTEST_S, Judged, Judging, Points, Row, Task
from gateway_fleet.study.drives.tables import columns_of
from gateway_fleet.study.drives.vehicles import Learned, Learning, vehicles
from gateway_replay.pool import Pool, Work, Workers, default_workers

Item = TypeVar("Item")
Done = TypeVar("Done")


@dataclass(frozen=True)
class Study:
    """Results of all vehicles.

    Attributes:
        seed: of all randomness.
        learned: vehicles, by name.
        healthy: their other drives as they are.
        faulty: drives with faults put in.
    """

    seed: int
    learned: Sequence[Learned]
    healthy: Sequence[Judged]
    faulty: Sequence[Judged]

    @property
    def hours(self) -> float:
        """Length of the healthy drives [h]."""
        return sum(one.seconds for one in self.healthy) / 3600.0

    @property
    def codes(self) -> list[str]:
        """False codes of the healthy drives."""
        return [code for one in self.healthy for code in one.codes]

    @property
    def causes(self) -> list[str]:
        """False causes of the healthy drives."""
        return [cause for one in self.healthy for cause in one.causes]

    @property
    def errors(self) -> list[str]:
        """Vehicles and drives that could not be learned of or judged, a line each."""
        bad = [f"{one.vehicle}: {one.error}" for one in self.learned if one.error]
        return bad + [f"{one.drive}: {one.error}" for one in [*self.healthy, *self.faulty] if one.error]

    @property
    def points(self) -> Points:
        """Rows of all tables with a truth."""
        total = Points()
        for one in self.healthy:
            total.add(one.points or Points())
        return total

    def kinds(self, *senders: str) -> dict[str, Row]:
        """Return kind of a fault -> what came of all of it, in vehicles whose databases name ``senders`` or do not."""
        total: dict[str, Row] = {}
        for drive in self.faulty:
            for kind, row in drive.faults.items() if drive.senders in senders else ():
                total.setdefault(kind, Row()).add(row)
        return total


def drives(
    folder: Path,
    *,
    faults: int,
    seed: int,
    workers: int | None,
    out: Path | None,
    false_per_hour: float,
    column: Sequence[str],
    json: bool,
) -> int:
    """Learn of one drive of each vehicle of a folder, judge the others; returns the exit code: 2 if one could not be.

    Args:
        folder: a folder a vehicle.
        faults: of each kind that are put in a vehicle's other drives.
        seed: of all randomness.
        workers: on this machine; None: one per core.
        out: folder that keeps what is learned.
        false_per_hour: false codes that are accepted [1/h].
        column: roles of the columns of tables, ``ROLE=NAME``.
        json: print JSON.

    Raises:
        InputError: the folder is not there, or has no log.
    """
    count = default_workers() if workers is None else workers
    if count:
        need("fleet", "workers on this machine")
    found = vehicles(folder, columns_of(column))
    with ExitStack() as stack:
        work = (out or Path(stack.enter_context(TemporaryDirectory()))).absolute()
        say(f"seed {seed}; {len(found)} vehicles, the largest log of each is learned of")
        learned = sorted(
            _done(Learning(work, seed, false_per_hour), found, "vehicles", count, stack), key=lambda one: one.vehicle
        )
        tasks = [Task(one, drive) for one in learned if one.config is not None for drive in one.judged]
        healthy = _done(Judging(), tasks, "healthy drives", count, stack)
        more = list(_with_faults(tasks, healthy, faults, seed))
        faulty = _done(Judging(), more, "drives with faults", count, stack)
    study = Study(seed, learned, sorted(healthy, key=_place), sorted(faulty, key=_place))
    if json:
        print_json(_data(study))
    else:
        _print(study)
    return 2 if study.errors else 0


def _place(judged: Judged) -> tuple[str, str]:
    return judged.vehicle, str(judged.drive)


def _done(work: Work[Item, Done], tasks: Sequence[Item], what: str, count: int, stack: ExitStack) -> list[Done]:
    """Return the outcomes of tasks, as they came."""
    progress, outcomes = LogsDone(what), list[Done]()
    for outcome in Pool(work, Workers(count=count), stack).run(tasks):
        outcomes.append(outcome)
        progress(len(tasks) - len(outcomes))
    return outcomes


def _with_faults(tasks: Sequence[Task], healthy: Sequence[Judged], faults: int, seed: int) -> Iterator[Task]:
    """Yield each vehicle's drives in turn, so often as faults are asked for; a drive that is too short has none."""
    good = (one for one in healthy if one.seconds >= SHORTEST_S and not one.error and one.points is None)
    long = {(one.vehicle, one.drive) for one in good}
    for name, some in groupby(tasks, key=lambda task: task.learned.vehicle):
        mine = [task for task in some if (name, task.drive) in long]
        for k in range(faults if mine else 0):
            number = int.from_bytes(sha256(f"{seed} {name} {k}".encode()).digest()[:6])
            yield replace(mine[k % len(mine)], seed=number)


def _by_kind(codes: Sequence[str]) -> Counter[str]:
    """Return how often codes are of each kind: what stands behind the last dot of their names."""
    return Counter(code.rpartition(".")[2] for code in codes)


def _data(study: Study) -> dict[str, Any]:
    return {
        "seed": study.seed,
        "hours": study.hours,
        "false_codes": len(study.codes),
        "false_causes": len(study.causes),
        "false_kinds": _by_kind(study.codes),
        "faults": _rows(study.kinds(*SENDERS)),
        "faults_by_senders": {of: _rows(study.kinds(of)) for of in SENDERS},
        "points": asdict(study.points),
        "errors": study.errors,
        "vehicles": [
            asdict(replace(one, truth=None)) | {"judged": len(one.judged), "config": str(one.config)}
            for one in study.learned
        ],
        "drives": [asdict(one) | {"drive": str(one.drive)} for one in (*study.healthy, *study.faulty)],
    }


def _rows(kinds: Mapping[str, Row]) -> dict[str, Any]:
    return {kind: asdict(row) | {"judged": row.judged} for kind, row in kinds.items()}


def _print(study: Study) -> None:
    table = table_of("vehicle", "learned of", "drives", "judged", "false codes", "false causes")
    for one in study.learned:
        mine = [drive for drive in study.healthy if drive.vehicle == one.vehicle and not drive.error]
        codes = _by_kind([code for drive in mine for code in drive.codes])
        causes = Counter(cause for drive in mine for cause in drive.causes)
        lengths = f"{one.seconds:.0f} s", f"{len(mine)}", f"{sum(drive.seconds for drive in mine):.0f} s"
        cells = ("-", "-", "-") if one.error else lengths
        table.add_row(one.vehicle, *cells, _counted(codes), _counted(causes))
    wide_console().print(table)
    heads = "tried", "not judged here", "judged", "found", "silent", "cause right", "wrong", "code of a healthy part"
    for of in SENDERS:
        table = table_of(f"fault, senders {of}", *heads)
        for kind, row in study.kinds(of).items():
            beyond = f"{row.beyond}, {row.beyond_found} found"
            numbers = (row.judged, row.found, row.judged - row.found, row.right, row.wrong, row.accused)
            table.add_row(kind, str(row.tried), beyond, *map(str, numbers))
        if table.row_count:
            wide_console().print(table)
    if (points := study.points).wrong:
        print(
            f"tables: {points.found} of {points.wrong} rows found ({points.found / points.wrong:.3f}),"
            f" {points.false} of {points.healthy} healthy ones told ({points.false / max(points.healthy, 1):.3f})"
        )
    print(
        f"healthy: {len(study.codes)} false codes, {len(study.causes)} false causes in {study.hours:.2f} h; seed"
        f" {study.seed}"
    )
    for line in study.errors:
        say(line)


def _counted(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.most_common()) or "0"
