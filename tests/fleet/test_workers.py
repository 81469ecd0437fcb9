"""Workers that are processes: killed ones, a log that kills its worker, a scheduler and workers of their own."""

import os
import signal
import subprocess
import sys
from contextlib import ExitStack

import dask
import distributed
import long_log
import psutil
import pytest
from amount import amount
from fleet_logs import tables_hash, write_config, write_fleet

from gateway_fleet.fleet.run import Order, run
from gateway_fleet.fleet.verdicts import Verdicts
from gateway_logs.corpus import find
from gateway_replay.pool import Pool, Workers

pytestmark = [pytest.mark.long, pytest.mark.system]

#: Loaded by workers: a log of this name kills the worker that judges it.
POISON = """
import os, signal
from gateway_fleet.fleet import task

judged = getattr(task, "before", task._judged)  # Dask loads this twice
task.before = judged

def poisoned(setup, config, recording, *rest):
    if recording.path.name == "poison.log":
        os.kill(os.getpid(), signal.SIGKILL)
    return judged(setup, config, recording, *rest)

task._judged = poisoned
"""


def workers():
    """Return the process ids of the workers that this process's cluster has."""
    found = []
    for child in psutil.Process().children(recursive=True):
        try:
            if "spawn_main" in " ".join(child.cmdline()):
                found.append(child.pid)
        except psutil.Error:
            continue
    return found


@pytest.fixture
def fleet(tmp_path):
    """Logs, among them a corrupt and an empty one, and what a serial run makes of them."""
    write_config(tmp_path)
    paths = write_fleet(tmp_path / "logs", amount(200, 16), frames=1000)
    whole = paths[0].read_bytes()
    (tmp_path / "logs" / "car0" / "corrupt.log").write_bytes(whole[:9000] + b"nonsense\n")
    (tmp_path / "logs" / "car1" / "empty.log").write_bytes(b"")
    run(Order(find([tmp_path / "logs"]), tmp_path / "car.toml", tmp_path / "serial", workers=0))
    return tmp_path


def test_a_killed_worker_and_a_log_that_kills_its_own(fleet):
    (fleet / "logs" / "car2" / "poison.log").write_bytes((fleet / "logs" / "car0" / "00000.log").read_bytes() + b"\n")
    (fleet / "poison.py").write_text(POISON)
    killed = []

    def progress(outcome, left):
        if not killed and left < len(recordings) // 2:
            killed.append(workers()[0])
            os.kill(killed[0], signal.SIGKILL)

    recordings = find([fleet / "logs"])
    # As on a machine where a worker's new start takes longer than Dask waits for it: it gives up that worker for good.
    hurry = {"distributed.deploy.lost-worker-timeout": "1ms"}
    with dask.config.set({"distributed.worker.preload": [str(fleet / "poison.py")], **hurry}):
        result = run(Order(recordings, fleet / "car.toml", fleet / "out", workers=2), progress)
    assert killed
    states = {outcome.recording.path.name: outcome.state for outcome in result.outcomes}
    assert {name: state for name, state in states.items() if state != "whole"} == {
        "corrupt.log": "damaged", "empty.log": "empty", "poison.log": "killed",
    }  # fmt: skip
    verdicts = Verdicts(fleet / "out")
    assert sorted(row["kind"] for row in verdicts.rows("errors")) == ["damaged", "empty", "killed"]
    (poisoned,) = (row["log"] for row in verdicts.rows("errors") if row["kind"] == "killed")
    verdicts.forget([poisoned])
    assert tables_hash(fleet / "out") == tables_hash(fleet / "serial"), "nobody else's work is lost, or done twice"
    assert not workers(), "the cluster is gone"


class Doubling:
    """Work: numbers are doubled; the second worker that is to double 0 dies of it."""

    def __init__(self, folder):
        self.folder = folder

    def do(self, task):
        if not task:
            times = len(list(self.folder.iterdir()))
            (self.folder / str(times)).touch()
            if times == 1:
                os.kill(os.getpid(), signal.SIGKILL)
        return [2 * task]

    def failed(self, task, text):
        return [text]

    def killed(self, task):
        return ["killed"], None


def test_outcomes_that_die_with_their_worker_before_they_are_fetched(tmp_path, monkeypatch):
    fetch = distributed.Future.result
    killed = []

    def result(future):
        if not killed and future.status == "finished":
            (address,) = future.client.who_has([future])[future.key]
            killed.append(future.client.run(os.getpid, workers=[address])[address])
            os.kill(killed[0], signal.SIGKILL)
        return fetch(future)

    monkeypatch.setattr(distributed.Future, "result", result)
    with ExitStack() as stack:
        outcomes = list(Pool(Doubling(tmp_path), Workers(count=2), stack).run([0]))
    assert killed
    assert outcomes == [0], "done again: it is neither lost nor blamed"
    assert len(list(tmp_path.iterdir())) == 3


class Asking:
    """Work: who listens on this machine for a cluster of ours, and what does a stranger get there."""

    def do(self, task):
        return [distributed.get_worker().scheduler.address, distributed.get_worker().address]

    def failed(self, task, text):
        return [text]

    def killed(self, task):
        return ["killed"], None


def test_nobody_else_on_this_machine_runs_code_at_our_workers():
    """Neither without a certificate nor with his own."""
    with ExitStack() as stack:
        pool = Pool(Asking(), Workers(count=1), stack)
        (scheduler, worker) = pool.run([0])
        for address in (scheduler, worker):
            assert address.startswith("tls://127.0.0.1:")
        open_ = f"tcp://127.0.0.1:{scheduler.rsplit(':', 1)[1]}"
        for address, security in ((open_, None), (scheduler, distributed.Security.temporary())):
            with pytest.raises(OSError, match="(?i)timed out|closed|tls|ssl|certificate"):  # noqa: SIM117
                with distributed.Client(address, security=security, timeout="2s", set_as_default=False) as client:
                    client.submit(os.getuid).result(10)
        assert list(pool.run([0])) == [scheduler, worker], "we go on"


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A scheduler and a worker that are processes of their own; yields its address, the worker, and their folder."""
    folder = tmp_path_factory.mktemp("own")
    with long_log.one_worker(folder) as (address, worker):
        yield address, worker, folder


@pytest.mark.full("9 s")
def test_a_scheduler_and_workers_of_their_own(fleet, own):
    address, _, folder = own
    assert address.startswith("tcp://127.0.0.1:")
    words = ("worker", "--nthreads", "1", "--no-dashboard", "--scheduler-file", str(folder / "scheduler.json"))
    with (folder / "second.out").open("w") as out:
        second = subprocess.Popen([sys.executable, "-m", "dask", *words, "--host", "127.0.0.1"], stdout=out, stderr=out)
    try:
        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=120)
        order = Order(find([fleet / "logs"]), fleet / "car.toml", fleet / "out", scheduler=address)
        result = run(order)
        assert len(result.outcomes) == len(order.recordings)
        assert run(order).outcomes == []
    finally:
        second.terminate()
        second.wait(60)
    assert tables_hash(fleet / "out") == tables_hash(fleet / "serial")


@pytest.mark.full("13 s")
def test_memory_of_a_worker_does_not_grow_with_the_length_of_a_log(tmp_path, own):
    """A worker of its own judges a log; bytes a frame that stayed would show: 8 of them are 19 MB here, 800 MB in full.

    In full 10^8 frames: as candump 5 GB, deleted with the folder. A short log goes first, so that all is loaded.
    """
    few, many = amount(10**6, 600_000), amount(10**8, 3_000_000)
    try:
        sizes = [judged(tmp_path, frames, *own[:2]) for frames in (1000, few, many)]
    finally:
        for path in tmp_path.rglob("*.log"):
            path.unlink()
    print([f"{size / 1e6:.0f} MB" for size in sizes])
    assert sizes[2] - sizes[1] < 16_000_000


def judged(folder, frames, address, worker):
    """Have a worker judge a log of so many frames; returns the greatest resident memory it has had [byte]."""
    config = write_config(folder)
    path = long_log.generate(folder / "logs" / f"{frames}.log", frames, every=50_000)
    (outcome,) = run(Order(find([path]), config, folder / "long", scheduler=address)).outcomes
    assert (outcome.state, outcome.frames) == ("whole", frames)
    return long_log.greatest(worker)
