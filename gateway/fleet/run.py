"""Many recordings judged: which are new, who does them, and what is made of workers that die.

Dask does them (https://distributed.dask.org): a cluster of processes on this machine, or workers anywhere that share
the logs' and the verdicts' folders. A worker that dies takes with it what it was doing, whoever was to blame. So what
was under way then is suspected, and done again at the end, one at a time: what kills its worker alone is a row of
``errors``, what does not is as if nothing had happened.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from gateway import __version__
from gateway.config.load import load_config
from gateway.errors import GatewayError, InputError
from gateway.fleet.corpus import Recording
from gateway.fleet.task import Outcome, Setup, Task, digest_of, judge, refuse, unreadable
from gateway.fleet.verdicts import Done, Manifest, Verdicts, signature

#: How often a recording that was under way when a worker died is tried alone.
TRIES = 2
#: How long a scheduler may take to have a worker [s].
PATIENCE_S = 120.0
#: States of recordings that could not be judged to their end.
FAILED = ("failed", "killed", "unreadable")

#: Takes each outcome, and how many recordings have none yet.
Progress = Callable[[Outcome, int], None]


@dataclass(frozen=True)
class Order:
    """What is to be done.

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
    """What was done.

    Attributes:
        known: recordings that had their verdict.
        outcomes: of the others.
    """

    known: int = 0
    outcomes: list[Outcome] = field(default_factory=list)


def default_workers() -> int:
    """Return how many workers a cluster on this machine gets: a core each."""
    return max(1, len(os.sched_getaffinity(0)))


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
    for outcome in _done(order, verdicts, list(_tasks(setup, new, last))):
        left -= 1
        files = _signature(outcome.recording)
        more = {"seconds": round(outcome.seconds, 3), "frames": outcome.frames, "dtcs": outcome.dtcs}
        manifest.add(outcome.recording.path, Done(files, outcome.log, outcome.state), more)
        result.outcomes.append(outcome)
        progress(outcome, left)
    return result


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
    last: dict[str, str] = {}
    for recording in order.recordings:
        absolute = Recording(recording.path.absolute(), recording.device)
        done = manifest.done.get(str(absolute.path))
        known = done is not None and verdicts.has(done.log) and done.files == _signature(absolute)
        if known and done is not None and order.retry and done.state in FAILED:
            verdicts.forget(done.log)
            known = False
        if not known or done is None:
            new.append(absolute)
            continue
        if order.carried and any(one.device == absolute.device for one in new):
            first = next(one for one in new if one.device == absolute.device)
            text = f"comes before {absolute.path.name}, whose verdict has a memory without it; take another --out"
            raise InputError(text, file=first.path)
        if (verdicts.folder / "memory" / f"{done.log}.sqlite").exists():
            last[absolute.device] = done.log
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


def _done(order: Order, verdicts: Verdicts, tasks: Sequence[Task]) -> Iterator[Outcome]:
    """Have tasks done; yields what comes out as it does."""
    if not tasks:
        return
    if order.scheduler is None and order.workers == 0:
        for task in tasks:
            yield from judge(task)
        return
    with ExitStack() as stack:
        pool = _Pool(_client(order, stack), verdicts)
        yield from pool.run(tasks)


def _client(order: Order, stack: ExitStack) -> Any:
    """Return a connection to workers.

    Raises:
        InputError: there is no scheduler at the address, or it has no worker.
    """
    import dask  # noqa: PLC0415 - an extra, slow to load
    from distributed import Client, LocalCluster  # noqa: PLC0415

    address: Any = order.scheduler
    if address is None:
        # Who dies takes one suspect along; all else is ours (see the module).
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": 0}))
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        address = stack.enter_context(
            LocalCluster(
                n_workers=order.workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None if order.dashboard is None else f"127.0.0.1:{order.dashboard}",
                silence_logs=logging.CRITICAL,
                local_directory=stack.enter_context(TemporaryDirectory(prefix="gateway-fleet-")),
            )
        )
    try:
        client = stack.enter_context(Client(address, timeout=f"{PATIENCE_S:.0f}s", set_as_default=False))
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no scheduler with a worker: {error}", key="--scheduler", value=order.scheduler) from error
    return client


class _Pool:
    """Tasks at Dask's workers, a few more than they do at once.

    Args:
        client: connection to them.
        verdicts: takes what could not be judged.
    """

    def __init__(self, client: Any, verdicts: Verdicts) -> None:
        self._client, self._verdicts = client, verdicts
        self._suspects: list[Task] = []

    def run(self, tasks: Sequence[Task]) -> Iterator[Outcome]:
        """Yield the outcomes of all tasks."""
        from distributed import as_completed  # noqa: PLC0415 - an extra

        waiting = list(reversed(tasks))
        under_way: dict[Any, Task] = {}
        done = as_completed(loop=self._client.loop, raise_errors=False)

        def fill() -> None:
            room = 2 * max(1, sum(self._client.nthreads().values()))
            while waiting and len(under_way) < room:
                task = waiting.pop()
                future = self._client.submit(judge, task, pure=False)
                under_way[future] = task
                done.add(future)

        fill()
        while under_way:
            future = next(done)
            task = under_way.pop(future)
            found = self._result(future, task)
            if found is None:
                self._suspects.append(task)
            else:
                yield from found
            fill()
        for task in self._suspects:
            yield from self._alone(task)

    def _result(self, future: Any, task: Task) -> list[Outcome] | None:
        """Return the outcomes of a task, None if its worker died.

        Raises:
            GatewayError: the worker refuses: no other task would fare better.
        """
        from distributed import KilledWorker  # noqa: PLC0415 - an extra

        if future.status == "finished":
            found: list[Outcome] = future.result()
            return found
        error = future.exception() if future.status == "error" else None
        if isinstance(error, KilledWorker) or error is None:
            return None
        if isinstance(error, GatewayError):
            raise error
        text = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return [self._refused(recording, "failed", text) for recording in task.recordings]

    def _alone(self, task: Task) -> Iterator[Outcome]:
        """Try a suspect while nothing else is done; of several recordings, those before the guilty one count."""
        for _ in range(TRIES):
            future = self._client.submit(judge, task, pure=False)
            with suppress(Exception):  # cancelled with its worker
                future.exception()
            found = self._result(future, task)
            if found is not None:
                yield from found
                return
        for k, recording in enumerate(task.recordings):
            log = self._log_of(recording)
            if self._verdicts.has(log):
                (row,) = self._verdicts.rows("logs", log)
                yield Outcome(recording, log, row["state"], row["frames"], row["dtcs"], 0.0)
                continue
            yield self._refused(recording, "killed", "its worker died of it, alone")
            rest = task.recordings[k + 1 :]
            if rest:
                before = [self._log_of(one) for one in task.recordings[:k]]
                kept = [log for log in before if (self._verdicts.folder / "memory" / f"{log}.sqlite").exists()]
                yield from self._alone(Task(task.setup, rest, kept[-1] if kept else task.before))
            return

    def _log_of(self, recording: Recording) -> str:
        try:
            return recording.digest()
        except InputError:
            return unreadable(recording)

    def _refused(self, recording: Recording, kind: str, text: str) -> Outcome:
        return refuse(self._verdicts, recording, self._log_of(recording), kind, text)
