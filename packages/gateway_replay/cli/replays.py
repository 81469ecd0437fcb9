"""``gateway replay`` of several logs: each by itself, its lines in the order of the logs."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from gateway.cli.failure import BUG, ended_by, refuse
from gateway.cli.progress import LogsDone
from gateway.common.extras import need
from gateway_fdi.errors import InputError
from gateway_replay.cli.replay import replay

#: Options that name a file for one log.
_OF_ONE = {"memory": "--memory", "html": "--html", "series": "--signals", "plot": "--plot", "junit": "--junit"}
#: Outputs of a replay.
_STREAMS = ("out", "err")


@dataclass(frozen=True)
class Task:
    """One log for a worker.

    Attributes:
        place: of it among the logs.
        log: it.
        config: file of the configuration.
        options: of :func:`gateway_replay.cli.replay.replay`.
        folder: takes what would go to stdout and stderr.
    """

    place: int
    log: Path
    config: Path | None
    options: dict[str, Any]
    folder: Path

    def file(self, stream: str) -> Path:
        """Return what takes the lines for ``out`` or ``err``."""
        return self.folder / f"{self.place}.{stream}"


def replays(logs: Sequence[Path], config: Path | None, *, jobs: int, **options: Any) -> int:
    """Replay logs; returns the highest exit code of them.

    Args:
        logs: one or more.
        config: file of the configuration.
        jobs: processes; 0: a core each.
        options: of :func:`gateway_replay.cli.replay.replay`, for each log.

    Raises:
        InputError: several logs would write the same file.
    """
    if len(logs) == 1:
        return replay(logs[0], config, **options)
    for name, key in _OF_ONE.items():
        if options.get(name) is not None:
            text = f"of one log, and here are {len(logs)}: each would overwrite it"
            raise InputError(text, key=key, value=str(options[name]))
    from gateway_replay.pool import default_workers  # noqa: PLC0415 - few replay several logs

    jobs = min(jobs or default_workers(), len(logs))
    if jobs == 1:
        return max(_replay_among(log, config, options) for log in logs)
    need("fleet", "several logs at once", key="--jobs")
    return _at_once(logs, config, jobs, options)


def _replay_among(log: Path, config: Path | None, options: dict[str, Any]) -> int:
    """Replay one of several logs, and say what ended it; returns its exit code."""
    if not options["json"]:
        print(f"{log}:", flush=True)
    try:
        return replay(log, config, among=True, **options)
    except BrokenPipeError:
        raise
    except Exception as error:
        return ended_by(error)


class _Replaying:
    """The work of several replays at once (:class:`gateway_replay.pool.Work`): outcomes are places and exit codes."""

    def do(self, task: Task) -> list[tuple[int, int]]:
        """Replay a log, at a worker."""
        with TemporaryDirectory(dir=task.folder) as mine:
            made = {stream: Path(mine) / stream for stream in _STREAMS}
            with (
                made["out"].open("w", encoding="utf-8") as out,
                made["err"].open("w", encoding="utf-8") as err,
                redirect_stdout(out),
                redirect_stderr(err),
            ):
                code = _replay_among(task.log, task.config, task.options)
            # If a worker dies that had done it, Dask has it done again, maybe while its lines are being told.
            for stream, path in made.items():
                path.replace(task.file(stream))
        return [(task.place, code)]

    def failed(self, task: Task, text: str) -> list[tuple[int, int]]:
        """Say what was raised beyond the replay itself."""
        with task.file("err").open("a", encoding="utf-8") as err, redirect_stderr(err):
            refuse(f"{task.log}: {text}")
        return [(task.place, BUG)]

    def killed(self, task: Task) -> tuple[list[tuple[int, int]], None]:
        """Say which log kills who replays it."""
        return self.failed(task, "its process died of it, alone"), None


def _at_once(logs: Sequence[Path], config: Path | None, jobs: int, options: dict[str, Any]) -> int:
    from gateway_replay.pool import Pool, Workers  # noqa: PLC0415 - behind need()

    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="gateway-replays-")))
        pool: Pool[Task, tuple[int, int]] = Pool(_Replaying(), Workers(count=jobs), stack)
        here = config if config is None else config.absolute()
        tasks = [Task(k, log, here, options, folder) for k, log in enumerate(logs)]
        codes: dict[int, int] = {}
        told, progress = 0, LogsDone()
        for place, code in pool.run(tasks):
            codes[place] = code
            progress.clear()
            while told in codes:
                _print(tasks[told])
                told += 1
            progress(len(logs) - len(codes))
        return max(codes.values())


def _print(task: Task) -> None:
    """Print what a worker would have printed."""
    for stream, to in zip(_STREAMS, (sys.stdout, sys.stderr), strict=True):
        path = task.file(stream)
        if not path.exists():
            continue  # its worker died before
        with path.open(encoding="utf-8") as lines:
            shutil.copyfileobj(lines, to)
        to.flush()
        path.unlink()
