"""Many recordings judged: new ones, their workers (:mod:`gateway_replay.pool`), and the finished ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from gateway import __version__
from gateway.config.load import load_config
from gateway_fdi.errors import InputError
from gateway_fleet.fleet.task import Outcome, Setup, Task, digest_of, judge, log_of, refuse, unreadable
from gateway_fleet.fleet.verdicts import Done, Manifest, Verdicts, signature
from gateway_logs.corpus import Recording
from gateway_replay.pool import Pool, Workers

#: States of recordings that could not be judged to their end.
FAILED = ("failed", "killed", "unreadable")

#: Takes each outcome, and how many recordings have none yet.
Progress = Callable[[Outcome, int], None]


@dataclass(frozen=True)
class Order:
    """Work to be done.

    Attributes:
        recordings: all of them.
        config: file of the configuration.
        out: folder of the verdicts.
        maps: further channels.
        carried: whether the logs of a device share a fault memory.
        scheduler: address of a scheduler, None: a cluster on this machine.
        workers: of that; 0: none, all is done in this process.
        retry: whether recordings that failed are done again.
        dashboard: port of Dask's dashboard on 127.0.0.1, None: none.
    """

    recordings: Sequence[Recording]
    config: Path
    out: Path
    maps: tuple[str, ...] = ()
    carried: bool = False
    scheduler: str | None = None
    workers: int = 1
    retry: bool = False
    dashboard: int | None = None


@dataclass
class Result:
    """Work that was done.

    Attributes:
        known: recordings that had their verdict.
        outcomes: of the others.
        copies: recordings with the contents of another one, which count once.
    """

    known: int = 0
    outcomes: list[Outcome] = field(default_factory=list)
    copies: list[Path] = field(default_factory=list)


def run(order: Order, progress: Progress = lambda outcome, left: None) -> Result:
    """Judge the recordings that have no verdict yet.

    Raises:
        InputError, InputErrors: the configuration or its databases are wrong, the folder is of another run, no worker.
    """
    config_path = order.config.absolute()
    setup = Setup(
        config_path, digest_of(load_config(config_path), order.maps), order.maps, order.carried, order.out.absolute()
    )
    verdicts, manifest = Verdicts(setup.out), Manifest(setup.out)
    verdicts.prepare()
    memory = "carried" if order.carried else "fresh"
    manifest.agree(
        {"configuration": setup.digest, "memory": memory, "version": __version__, "config": str(config_path)}
    )
    result = Result()
    new, last = _new(order, manifest, verdicts)
    result.known = len(order.recordings) - len(new)
    left = len(new)
    # As they were before anybody read them: one that changes meanwhile is new to the next run.
    files = {recording.path: _signature(recording) for recording in new}
    with ExitStack() as stack:
        pool = Pool(_Judging(setup.out), Workers(order.scheduler, order.workers, order.dashboard), stack)
        for outcome in pool.run(list(_tasks(setup, new, last))):
            left -= 1
            path = outcome.recording.path
            before = manifest.done.get(str(path))
            more = {"seconds": round(outcome.seconds, 3), "frames": outcome.frames, "dtcs": outcome.dtcs}
            manifest.add(path, Done(files[path], outcome.log, outcome.state), more)
            if before is not None and before.log != outcome.log and not manifest.paths(before.log):
                verdicts.forget([before.log])  # of what the file held before: a recording that went on counts once
            result.outcomes.append(outcome)
            progress(outcome, left)
    if result.outcomes:
        result.copies = _write_copies(order, manifest, verdicts, {one.log for one in result.outcomes if not one.fresh})
        verdicts.put_together()
    return result


def _write_copies(order: Order, manifest: Manifest, verdicts: Verdicts, moved: set[str]) -> list[Path]:
    """Have each verdict name the first recording of these contents, and each other one a row of ``errors``.

    The tables are the same in any order of judging.

    Args:
        order: with all recordings.
        manifest: of them.
        verdicts: of them.
        moved: logs whose verdict may name a path that is no more.

    Returns:
        the paths of the others.
    """
    same: dict[str, list[Recording]] = {}
    for recording in sorted(order.recordings, key=lambda one: str(one.path.absolute())):
        absolute = Recording(recording.path.absolute(), recording.device)
        if (done := manifest.done.get(str(absolute.path))) is not None:
            same.setdefault(done.log, []).append(absolute)
    copies = []
    for log, recordings in same.items():
        first, others = recordings[0], recordings[1:]
        if others or log in moved:
            verdicts.name(log, first)
        verdicts.write_copy(first, log, None)
        for other in others:
            verdicts.write_copy(other, log, first)
            copies.append(other.path)
    return copies


def _signature(recording: Recording) -> tuple[tuple[str, int, int], ...]:
    try:
        return signature(recording)
    except InputError:
        return ()


def _new(order: Order, manifest: Manifest, verdicts: Verdicts) -> tuple[list[Recording], dict[str, str]]:
    """Return the recordings without a verdict, and the last one of each device that has one.

    Raises:
        InputError: with a memory that is carried, a new recording lies before one that has its verdict.
    """
    new: list[Recording] = []
    again: list[str] = []
    last: dict[str, str] = {}
    seen: set[str] = set()
    for recording in order.recordings:
        absolute = Recording(recording.path.absolute(), recording.device)
        done = manifest.done.get(str(absolute.path))
        known = done is not None and verdicts.has(done.log) and done.files == _signature(absolute)
        if known and done is not None and order.retry and done.state in FAILED:
            again.append(done.log)
            known = False
        if not known or done is None:
            new.append(absolute)
            continue
        if order.carried and any(one.device == absolute.device for one in new):
            first = next(one for one in new if one.device == absolute.device)
            text = f"comes before {absolute.path.name}, whose verdict has a memory without it; take another --out"
            raise InputError(text, file=first.path)
        if done.log not in seen and (verdicts.folder / "memory" / f"{done.log}.sqlite").exists():
            last[absolute.device] = done.log
        seen.add(done.log)  # a copy does not take the memory back to where the first one stood
    verdicts.forget(again)
    return new, last


def _tasks(setup: Setup, new: Sequence[Recording], last: dict[str, str]) -> Iterator[Task]:
    """Yield a task a recording, or one a device, if memories are carried."""
    if not setup.carried:
        for recording in new:
            yield Task(setup, (recording,))
        return
    for device in dict.fromkeys(recording.device for recording in new):
        mine = tuple(recording for recording in new if recording.device == device)
        yield Task(setup, mine, last.get(device, ""))


class _Judging:
    """The work of a run (:class:`gateway_replay.pool.Work`)."""

    def __init__(self, out: Path) -> None:
        self._verdicts = Verdicts(out)

    def do(self, task: Task) -> list[Outcome]:
        """Judge recordings."""
        return judge(task)

    def failed(self, task: Task, text: str) -> list[Outcome]:
        """Refuse all recordings of a task."""
        return [self._refused(task, recording, "failed", text) for recording in task.recordings]

    def killed(self, task: Task) -> tuple[list[Outcome], Task | None]:
        """Refuse the first recording without a verdict: those before it count, those after it are done."""
        outcomes = []
        for k, recording in enumerate(task.recordings):
            log = self._log_of(task, recording)
            if self._verdicts.has(log):
                (row,) = self._verdicts.rows("logs", log)
                outcomes.append(Outcome(recording, log, row["state"], row["frames"], row["dtcs"], 0.0))
                continue
            outcomes.append(self._refused(task, recording, "killed", "its worker died of it, alone"))
            rest = task.recordings[k + 1 :]
            if not rest:
                return outcomes, None
            before = [self._log_of(task, one) for one in task.recordings[:k]]
            kept = [log for log in before if (self._verdicts.folder / "memory" / f"{log}.sqlite").exists()]
            return outcomes, Task(task.setup, rest, kept[-1] if kept else task.before)
        return outcomes, None

    def _log_of(self, task: Task, recording: Recording) -> str:
        try:
            return log_of(task.setup, recording)
        except InputError:
            return unreadable(recording)

    def _refused(self, task: Task, recording: Recording, kind: str, text: str) -> Outcome:
        return refuse(self._verdicts, recording, self._log_of(task, recording), kind, text)
