"""Tasks at Dask's workers, and the treatment of workers that die (https://distributed.dask.org).

A cluster of processes on this machine, or workers anywhere that share the logs' and the results' folders. A worker that
dies takes its tasks with it, even those that are not to blame. So the tasks that it had are suspected, and done again
at the end, one at a time: a task that kills its worker alone is reported as such, the others count as if nothing had
happened.
"""

from __future__ import annotations

import logging
import signal
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from typing import Any, Generic, Protocol, TypeVar

from gateway.common import lazy_modules
from gateway.common.extras import need
from gateway.host.process import processors
from gateway_fdi.errors import GatewayError, InputError

#: How often a task that was under way when a worker died is tried alone.
TRIES = 2
#: Answer of Dask's HTTP servers without a dashboard: only that they are there.
_HEALTH = ["distributed.http.health"]
#: How long a scheduler may take to have a worker [s].
PATIENCE_S = 120.0

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


@dataclass(frozen=True)
class Workers:
    """Workers that do the tasks.

    Attributes:
        scheduler: address of a scheduler, None: a cluster on this machine.
        count: workers of that; 0: none, all is done in this process.
        dashboard: port of Dask's dashboard on 127.0.0.1, None: none.
    """

    scheduler: str | None = None
    count: int = 1
    dashboard: int | None = None


class Work(Protocol[Task, Outcome]):
    """Kind of the tasks, and the outcomes of those that cannot be done."""

    def do(self, task: Task) -> list[Outcome]:
        """Do a task, at a worker; this object is sent there."""

    def failed(self, task: Task, text: str) -> list[Outcome]:
        """Return the outcomes of a task that raised an unexpected error."""

    def killed(self, task: Task) -> tuple[list[Outcome], Task | None]:
        """Return the outcomes of a task that kills its worker, and the parts of it that are still to be done."""


def default_workers() -> int:
    """Return how many workers a cluster on this machine gets: a core each."""
    return processors()


class Pool(Generic[Task, Outcome]):
    """Has tasks done, a few more under way than workers do at once.

    Args:
        work: kind of the tasks.
        workers: do them; started when the first task comes.
        stack: ends them.
    """

    def __init__(self, work: Work[Task, Outcome], workers: Workers, stack: ExitStack) -> None:
        self._work, self._workers, self._stack = work, workers, stack
        self._client: Any = None

    def run(self, tasks: Sequence[Task]) -> Iterator[Outcome]:
        """Yield the outcomes of all tasks, as they come.

        Raises:
            GatewayError: a worker refuses: no other task would fare better.
            InputError: there is no scheduler, or it has no worker.
        """
        if not tasks:
            return
        if self._workers.scheduler is None and self._workers.count == 0:
            for task in tasks:
                yield from self._work.do(task)
            return
        if self._client is None:
            self._client = _client(self._workers, self._stack)
        yield from self._run(tasks)

    def _run(self, tasks: Sequence[Task]) -> Iterator[Outcome]:
        from distributed import as_completed  # noqa: PLC0415 - an extra

        waiting, suspects = list(reversed(tasks)), []
        under_way: dict[Any, Task] = {}
        done = as_completed(loop=self._client.loop, raise_errors=False)

        def fill() -> None:
            room = 2 * max(1, sum(self._client.nthreads().values()))
            while waiting and len(under_way) < room:
                task = waiting.pop()
                future = self._client.submit(self._work.do, task, pure=False)
                under_way[future] = task
                done.add(future)

        fill()
        while under_way:
            future = next(done)
            task = under_way.pop(future)
            found = self._result(future, task)
            if found is None:
                suspects.append(task)
            else:
                yield from found
            fill()
        for task in suspects:
            yield from self._alone(task)

    def _result(self, future: Any, task: Task) -> list[Outcome] | None:
        """Return the outcomes of a task, None if its worker died.

        That may be told only here: a worker may die with the outcomes of a task that has finished, and so may the next
        one, that was to find them again.
        """
        from distributed import CancelledError, KilledWorker  # noqa: PLC0415 - an extra

        try:
            found: list[Outcome] = future.result()
        except (KilledWorker, CancelledError):
            return None
        except GatewayError:
            raise
        except Exception as error:
            return self._work.failed(task, f"{type(error).__name__}: {' '.join(str(error).split())}")
        return found

    def _alone(self, task: Task) -> Iterator[Outcome]:
        """Try a suspect while nothing else is done."""
        for _ in range(TRIES):
            future = self._client.submit(self._work.do, task, pure=False)
            found = self._result(future, task)
            if found is not None:
                yield from found
                return
        outcomes, rest = self._work.killed(task)
        yield from outcomes
        if rest is not None:
            yield from self._alone(rest)


def _client(workers: Workers, stack: ExitStack) -> Any:
    """Return a connection to workers.

    Raises:
        InputError: there is no scheduler at the address, or it has no worker.
    """
    import dask  # noqa: PLC0415 - an extra, slow to load
    from distributed import Client, LocalCluster, Security  # noqa: PLC0415

    address: Any = workers.scheduler
    if address is None:
        # A worker that dies takes one suspect along; this module does the rest (see above).
        # Its profiler keeps what each worker did in each second: 50 kB a second that a log takes.
        # On a busy machine its new start takes longer than Dask waits before it gives it up for good.
        settings: dict[str, Any] = {
            "distributed.deploy.lost-worker-timeout": "1d",
            "distributed.scheduler.allowed-failures": 0,
            "distributed.worker.profile.enabled": False,
            "distributed.worker.preload": [lazy_modules.__name__, *dask.config.get("distributed.worker.preload")],
        }
        if workers.dashboard is None:
            # Servers of HTTP are there all the same, and anybody on this machine can ask them.
            settings |= {"distributed.scheduler.http.routes": _HEALTH, "distributed.worker.http.routes": _HEALTH}
        # A port on 127.0.0.1 is open to every user of this machine, and workers run what they are sent. So both sides
        # show a certificate that lives in our memory only.
        need("fleet", "workers on this machine")
        stack.enter_context(dask.config.set(settings))
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        with children_that_go_on():
            address = stack.enter_context(
                LocalCluster(
                    n_workers=workers.count,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    security=Security.temporary(),
                    # Without a dashboard there is still a server, whose usual port another program may have.
                    dashboard_address=f"127.0.0.1:{workers.dashboard or 0}",
                    scheduler_kwargs={"dashboard": workers.dashboard is not None},
                    silence_logs=logging.CRITICAL,
                    local_directory=stack.enter_context(TemporaryDirectory(prefix="gateway-fleet-")),
                )
            )
    try:
        client = stack.enter_context(Client(address, timeout=f"{PATIENCE_S:.0f}s", set_as_default=False))
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no scheduler with a worker: {error}", key="--scheduler", value=workers.scheduler) from error
    return client


@contextmanager
def children_that_go_on() -> Iterator[None]:
    """Have processes and threads that begin within, and theirs, not hear Ctrl-C: this process ends them in order."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker  # noqa: PLC0415 - few want it

    resource_tracker.ensure_running()  # begun later, it has its thread's children hear Ctrl-C again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
