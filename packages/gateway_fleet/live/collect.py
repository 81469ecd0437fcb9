"""The collector: batches of a fleet's cars come by a broker or by HTTP, and go through the inbox into the tables."""

from __future__ import annotations

import json
import queue
import re
import sqlite3
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError, InputError
from gateway_fleet.live.batch import Batch, unpacked
from gateway_fleet.live.inbox import Inbox, Kept
from gateway_fleet.live.tables import export, prepare

#: Batches that wait to be written; who sends more waits. Batches of one write at most, and how long it waits for
#: more [s]: a disk takes a hundred of them as it takes one.
MOST_WAITING, MOST_TOGETHER, TOGETHER_S = 1000, 200, 0.05
#: Pause after a write that failed [s].
REST_S = 1.0
_EVENTS = re.compile(r"fleet/([^/]+)/car/([^/]+)/events")

log = get_logger(__name__)


@dataclass(frozen=True)
class Came:
    """A payload that came.

    Attributes:
        car: whom the way that it came by knows as its sender.
        payload: the batch.
        answer: called with its digest when all of it is on the disk; with "": it is refused.
    """

    car: str
    payload: bytes
    answer: Callable[[str], None]


class Collector:
    """Keeps what cars tell.

    Args:
        folder: of the tables; the inbox lies in it.
        fleet: whose cars these are.
        every_s: time between two writes into the tables [s].

    Raises:
        InputError: the folder cannot be used.
    """

    def __init__(self, folder: Path, fleet: str, every_s: float = 3600.0) -> None:
        prepare(folder)
        self._folder, self._fleet, self._every_s = folder, fleet, every_s
        self.inbox = Inbox(folder / "inbox.sqlite")
        self._waiting: queue.Queue[Came] = queue.Queue(MOST_WAITING)
        self._due_s = 0.0
        self.kept = Kept()

    def put(self, came: Came) -> None:
        """Take a payload, of any thread; waits where too many wait."""
        self._waiting.put(came)

    def run(self, stop: Callable[[], bool]) -> None:
        """Keep what comes until told to stop; then all of it is in the tables."""
        while not stop():
            self.turn()
        while not self._waiting.empty():
            self.turn()
        self._export(time.time())

    def turn(self) -> None:
        """Keep what waits, and answer it; put it into the tables if it is time."""
        came = self._next()
        batches = [(one, batch) for one in came if (batch := self._batch(one)) is not None]
        if batches:
            self._keep(batches)
        now_s = time.time()
        if now_s >= self._due_s:
            self._due_s = (now_s // self._every_s + 1) * self._every_s
            self._export(now_s)

    def _keep(self, batches: list[tuple[Came, Batch]]) -> None:
        """Keep batches, and answer them."""
        try:
            kept = self.inbox.take([batch for _, batch in batches], time.time_ns())
        except sqlite3.OperationalError as error:  # a disk that is full: cars keep what is not answered
            log.error("the inbox cannot be written; cars send it again", reason=str(error))
            time.sleep(REST_S)
            return
        except Exception as error:  # one that nobody thought of costs no other batch
            if len(batches) > 1:
                for one in batches:
                    self._keep([one])
                return
            log.exception("a batch cannot be kept", car=batches[0][1].car, reason=repr(error))
            self._refuse(batches[0][0], f"it cannot be kept: {error!r}")
            return
        for came, batch in batches:
            came.answer(batch.digest)
        self.kept = Kept(*(a + b for a, b in zip(vars(self.kept).values(), vars(kept).values(), strict=True)))

    def _refuse(self, came: Came, reason: str) -> None:
        log.warning("a batch is refused", car=came.car, reason=reason)
        try:
            with self.inbox.transaction():
                self.inbox.refuse(reason, came.car, came.payload[:200].hex(), time.time_ns())
        except sqlite3.OperationalError as error:
            log.error("the inbox cannot be written; the car sends it again", car=came.car, reason=str(error))
            return
        came.answer("")

    def _next(self) -> list[Came]:
        try:
            came = [self._waiting.get(timeout=0.2)]
        except queue.Empty:
            return []
        until_s = time.monotonic() + TOGETHER_S
        while len(came) < MOST_TOGETHER and (left_s := until_s - time.monotonic()) > 0:
            try:
                came.append(self._waiting.get(timeout=left_s))
            except queue.Empty:
                break
        return came

    def _batch(self, came: Came) -> Batch | None:
        """Return the batch that came; None: it is refused, and that is told."""
        try:
            batch = unpacked(came.payload)
            if batch.fleet != self._fleet:
                raise InputError(f"a car of another fleet: this is {self._fleet}", key="fleet", value=batch.fleet)
            if batch.car != came.car:
                raise InputError(f"of another car than its sender, {came.car}", key="car", value=batch.car)
        except InputError as error:
            self._refuse(came, str(error))
            return None
        return batch

    def _export(self, now_s: float) -> None:
        try:
            export(self.inbox, self._folder, datetime.fromtimestamp(now_s, UTC).strftime("%Y-%m-%d/%H"))
        except (GatewayError, OSError, sqlite3.Error) as error:
            log.error("the tables cannot be written; all of it stays in the inbox", reason=str(error))

    def close(self) -> None:
        """Close the inbox."""
        self.inbox.close()


def sender(topic: str, fleet: str) -> str:
    """Return the car of a topic, "" if it is no car's of this fleet."""
    found = _EVENTS.fullmatch(topic)
    return found[2] if found is not None and found[1] == fleet else ""


def arrived(digest: str) -> bytes:
    """Return what a car is answered whose batch is kept."""
    return json.dumps({"arrived": digest}).encode()
