"""All that a car's process does for its fleet: events, statistics, recordings, campaigns."""

from __future__ import annotations

import asyncio
import base64
import os
import signal
import time
from contextlib import suppress
from fnmatch import fnmatchcase
from itertools import compress
from pathlib import Path
from typing import Any

from gateway.config.model import Config
from gateway.faults.memory_reader import MemoryReader
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError, InputError
from gateway_fleet.live.causes import CauseCount
from gateway_fleet.live.join import Car
from gateway_fleet.live.shadow import Shadow
from gateway_fleet.live.statistics import Drive
from gateway_fleet.live.trials import SHADOW, Trials
from gateway_serve.link import Refused

#: How often time driven is noted, and the signals of conditions are asked for [s].
TURN_S = 5.0
#: Bytes of a recording in one event.
PART = 30_000

log = get_logger(__name__)


class Member:
    """A car in its fleet.

    Args:
        config: of the car, with a table [fleet].
        path: of its file.
        socket: status socket of its daemon.
        keys: keyring of the fleet; None: the car takes no campaigns.
    """

    def __init__(self, config: Config, path: Path, socket: Path, keys: Path | None) -> None:
        assert config.fleet is not None
        self.params, self._memory = config.fleet, config.memory.path
        self.drive = Drive(config.fleet.condition)
        self.car = Car(config.fleet, self._memory, socket, [self._on_message])
        self._causes, self._events = CauseCount(), list[dict[str, Any]]()
        self._shadow = Shadow(path.resolve(), self._memory.resolve().parent)
        self._trials: Trials | None = None
        if keys is not None:
            if config.fleet.limits is None:
                raise InputError("campaigns need a file for their limits", file=path, key="fleet.limits")
            file = self._memory.with_name(self._memory.name + ".campaign")
            self._trials = Trials(
                config.fleet, path, keys, file,
                shadow=self._shadow, reload=self._reload, post=self._events.append,
            )  # fmt: skip

    @property
    def topics(self) -> list[str]:
        """Topics of campaigns and keys, where the car takes them."""
        name = self.params.name
        return [] if self._trials is None else [f"fleet/{name}/keys", f"fleet/{name}/campaign/+"]

    def offer(self, _topic: str, payload: bytes) -> None:
        """Take a document that came."""
        if self._trials is not None and payload:
            self._trials.offer(payload)

    def _on_message(self, message: dict[str, Any], block: bytes) -> None:
        self.drive.on_message(message, block)
        if message["kind"] == "event":
            self._causes.take(message["event"])

    def _reload(self) -> None:
        """Have the daemon read its configuration again; one that does not run reads it when it begins."""
        pid = self.car.daemon
        if pid > 0:
            with suppress(OSError):
                os.kill(pid, signal.SIGHUP)

    async def run(self) -> None:
        """Keep what is to be told, and note time driven, until cancelled."""
        before, causes = time.monotonic(), self._causes.told
        try:
            while True:
                await asyncio.sleep(TURN_S if self._trials is None or self._trials.campaign is None else TURN_S / 5.0)
                now = time.monotonic()
                hours, before = (now - before) / 3600.0, now
                if self.car.connected:
                    await self._note_conditions()
                    if self._trials is not None:
                        self._drove(self._trials, hours, self._causes.told - causes)
                    causes = self._causes.told
                await self._report()
        finally:
            self._shadow.end()

    def _drove(self, trials: Trials, hours: float, causes: int) -> None:
        state = trials.state.state
        told = self._shadow.causes() if state == SHADOW and self._shadow.runs else 0
        if state == SHADOW and not self._shadow.runs:
            trials.give_up("its shadow has ended: shadow.log beside the fault memory says why")
            return
        trials.drove(hours, causes, told)
        if trials.campaign is not None and trials.campaign.recordings:
            self._events += self._recordings(trials)

    async def _note_conditions(self) -> None:
        if self.drive.signals:
            with suppress(Refused):
                self.drive.note((await self.car.link.ask("values", signals=self.drive.signals))["values"])

    async def _report(self) -> None:
        """Have the daemon keep events for the fleet, or write them where there is none."""
        statistics = self.drive.take()
        if self._trials is not None and self._trials.campaign is not None:
            statistics = _chosen(statistics, self._trials.campaign.tests)
        for events, back in ((statistics, self.drive.give_back), (list(self._events), None)):
            if not events:
                continue
            kept = await self.car.post(events) if self.car.connected else self._add(events)
            if back is None and kept:
                del self._events[: len(events)]
            elif back is not None and not kept:
                back(events)

    def _add(self, events: list[dict[str, Any]]) -> bool:
        try:
            return self.car.queue.add(events, self.params)
        except GatewayError as error:
            log.warning("events are not kept for the fleet yet", reason=str(error))
            return False

    def _recordings(self, trials: Trials) -> list[dict[str, Any]]:
        """Return the recordings that a campaign asks for, and that were not told yet, within its bytes."""
        campaign, made = trials.campaign, list[dict[str, Any]]()
        if campaign is None:
            return made
        memory = MemoryReader(self._memory)
        try:
            for each in memory.store().recordings():
                wanted = any(fnmatchcase(each.fault, pattern) for pattern in campaign.recordings)
                size = len(each.log)
                if not wanted or each.t_ns <= trials.state.recorded_ns or trials.state.bytes + size > campaign.bytes:
                    continue
                trials.state.bytes += size
                trials.state.recorded_ns = max(trials.state.recorded_ns, each.t_ns)
                parts = [each.log[at : at + PART] for at in range(0, size, PART)]
                made += [
                    {
                        "event": "recording", "t_ns": each.t_ns, "fault": each.fault, "frames": each.frames,
                        "dropped": each.dropped, "part": k, "parts": len(parts), "log": base64.b64encode(part).decode(),
                    }
                    for k, part in enumerate(parts)
                ]  # fmt: skip
        except (GatewayError, OSError) as error:
            log.warning("recordings are not read", reason=str(error))
        finally:
            memory.close()
        return made


def _chosen(events: list[dict[str, Any]], patterns: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return statistics of the tests that a campaign asks for."""
    made = []
    for event in events:
        wanted = [any(fnmatchcase(fault, one) for one in patterns) for fault in event["tests"]["fault"]]
        made.append(event | {"tests": {name: [*compress(of, wanted)] for name, of in event["tests"].items()}})
    return made
