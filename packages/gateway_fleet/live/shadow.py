"""A gateway in shadow: a process that hears the same frames, judges by other limits, and reports nothing.

It is ``gateway run`` with the car's configuration, whose buses are listen-only and which has no servers, clients and
sockets; its fault memory is its own, and gone with it. The causes that it would have told are read from the queue of
that memory.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import tomlkit

from gateway_fdi.common.log import get_logger
from gateway_fleet.live.causes import CauseCount
from gateway_fleet.live.queue import Queue

#: Tables that a shadow has not: others would hear of it, or it would ask.
_NOT = ("output", "status", "report", "record", "ecu")
#: Events read at once.
_MOST = 1000
#: Command of a gateway.
GATEWAY = (sys.executable, "-c", "from gateway.cli import main; main()")

log = get_logger(__name__)


class Shadow:
    """Runs a gateway beside a car's daemon.

    Args:
        config: the car's; files that it names are found from its folder.
        folder: for its memory and its log.
    """

    def __init__(self, config: Path, folder: Path) -> None:
        self._config = config.with_name(f".{config.stem}.shadow.toml")
        self._folder = folder
        self._memory = folder / "shadow.sqlite"
        self._process: subprocess.Popen[bytes] | None = None
        self._count, self._queue = CauseCount(), Queue(self._memory)

    def begin(self, tables: dict[str, Any]) -> None:
        """Begin with the tables of a configuration.

        Raises:
            OSError: it cannot be.
        """
        self.end()
        self._clean()
        self._count, self._queue = CauseCount(), Queue(self._memory)
        self._config.write_text(tomlkit.dumps(self._changed(tables)), encoding="utf-8")
        environment = {name: value for name, value in os.environ.items() if not name.startswith("GATEWAY_MEMORY")}
        with (self._folder / "shadow.log").open("wb") as output:
            self._process = subprocess.Popen(  # noqa: S603 - ourselves
                [*GATEWAY, "run", str(self._config)],
                stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=environment,
            )  # fmt: skip

    def _changed(self, tables: dict[str, Any]) -> dict[str, Any]:
        made = {name: value for name, value in tables.items() if name not in _NOT}
        made["bus"] = [{**bus, "listen_only": True} for bus in made["bus"]]
        made["monitor"] = [{k: v for k, v in each.items() if k != "send"} for each in made.get("monitor", [])]
        made["memory"] = {"path": str(self._memory)}
        made["fleet"] = {name: value for name, value in made["fleet"].items() if name != "limits"}
        return made

    @property
    def runs(self) -> bool:
        """Whether it runs."""
        return self._process is not None and self._process.poll() is None

    def causes(self) -> int:
        """Return how many causes it would have told since the last call."""
        before = self._count.told
        while rows := self._queue.read(_MOST)[0]:
            for row in rows:
                self._count.take(json.loads(row.body))
            self._queue.note([row.number for row in rows])
        return self._count.told - before

    def end(self) -> None:
        """End it, if it runs."""
        process, self._process = self._process, None
        if process is None:
            return
        self._queue.close()
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._clean()

    def _clean(self) -> None:
        with suppress(OSError):
            for path in (self._config, *self._folder.glob("shadow.sqlite*")):
                path.unlink(missing_ok=True)
