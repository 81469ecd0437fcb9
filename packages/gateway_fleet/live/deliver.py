"""Delivery of a car's events: a batch at a time, sent again until the collector has it on its disk."""

from __future__ import annotations

import asyncio
import json
import random
import ssl
import urllib.error
import urllib.request
from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol

from gateway.faults.fleet import FleetParams
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError
from gateway_fleet.live.batch import MOST_EVENTS, digest_of, packed, topic
from gateway_fleet.live.queue import Queue
from gateway_serve.broker import Broker, BrokerLink

#: How often the queue is looked at [s]. How long an answer is waited for at first, and at most: so long a car waits
#: before it sends again what got none [s].
LOOK_S, FIRST_S, LONGEST_S = 0.5, 10.0, 600.0

log = get_logger(__name__)


class Way(Protocol):
    """A way to the collector."""

    async def send(self, payload: bytes, wait_s: float) -> bool:
        """Send a batch; returns whether the collector has it, after this time at most [s]."""


class Delivery:
    """Sends what waits in a car.

    Args:
        queue: of the fault memory.
        car: whose it is.
        way: to the collector.
        taken: has rows taken away that have arrived.
    """

    def __init__(
        self, queue: Queue, car: FleetParams, way: Way, taken: Callable[[Sequence[int]], Awaitable[None]]
    ) -> None:
        self._queue, self._car, self._way, self._taken = queue, car, way, taken
        self._wait_s = FIRST_S
        self.sent = 0

    async def run(self) -> None:
        """Send until cancelled."""
        while True:
            if not await self.turn():
                await asyncio.sleep(LOOK_S)

    async def turn(self) -> bool:
        """Send the first batch that waits; returns whether it has arrived."""
        if stale := self._queue.stale(MOST_EVENTS):
            await self._taken(stale)
        rows, tally = self._queue.read(MOST_EVENTS)
        if not rows:
            return False
        payload, numbers = packed(self._car, rows, tally)
        if not await self._way.send(payload, self._wait_s):
            # Cars that all lost their collector at once do not all come back at once.
            self._wait_s = min(self._wait_s * random.uniform(1.5, 2.5), LONGEST_S)
            return False
        self._wait_s = FIRST_S
        self._queue.note(numbers)
        self.sent += len(numbers)
        await self._taken(numbers)
        return True


class ByBroker:
    """The way by a broker; to be made in the loop that uses it.

    Args:
        broker: the broker.
        car: who sends.
        others: topics that are listened to besides, and ``take``, which gets their messages in the loop.

    Raises:
        GatewayError: a certificate that is none, ...
    """

    def __init__(
        self,
        broker: Broker,
        car: FleetParams,
        others: Sequence[str] = (),
        take: Callable[[str, bytes], None] = lambda topic, payload: None,
    ) -> None:
        self._loop, self._take = asyncio.get_running_loop(), take
        self._events, answers = topic(car.name, car.car, "events"), topic(car.name, car.car, "arrived")
        self._answers = answers
        self._digest, self._answered = "", asyncio.Event()
        self._connected = asyncio.Event()
        self._link = BrokerLink(
            broker, f"car-{car.name}-{car.car}", [answers, *others],
            lambda name, payload: self._do(self._on_message, name, payload), lambda: self._do(self._connected.set),
        )  # fmt: skip

    def _do(self, work: Callable[..., None], *arguments: object) -> None:
        """Have something done in the loop, if that runs still."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(work, *arguments)

    def begin(self) -> None:
        """Connect."""
        self._link.begin()

    def end(self) -> None:
        """Take leave."""
        self._link.end()

    async def send(self, payload: bytes, wait_s: float) -> bool:
        """Publish a batch, and wait for its answer; a connection that comes back ends the wait."""
        if not self._link.is_there:
            self._connected.clear()
            try:
                await asyncio.wait_for(self._connected.wait(), wait_s)
            except TimeoutError:
                return False
        self._digest = digest_of(payload)
        self._answered.clear()
        self._connected.clear()
        self._link.publish(self._events, payload)
        waits = [asyncio.create_task(each.wait()) for each in (self._answered, self._connected)]
        try:
            await asyncio.wait(waits, timeout=wait_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for each in waits:
                each.cancel()
        return self._answered.is_set()

    def _on_message(self, name: str, payload: bytes) -> None:
        if name != self._answers:
            self._take(name, payload)
        elif digest_in(payload) == self._digest:
            self._answered.set()


def digest_in(payload: bytes) -> str:
    """Return the digest of the batch that an answer says is kept, "" if it says none."""
    try:
        told = json.loads(payload)
    except (ValueError, RecursionError):
        return ""
    found = told.get("arrived") if isinstance(told, dict) else None
    return found if isinstance(found, str) else ""


class ByPost:
    """The way by HTTP: a POST for each batch.

    Args:
        url: of the collector, without the path of the car.
        car: who sends.
        broker: has the certificates, as those of a broker; its host is not used.

    Raises:
        GatewayError: a certificate that is none, or a URL that is none.
    """

    def __init__(self, url: str, car: FleetParams, broker: Broker) -> None:
        if not url.startswith(("http://", "https://")):
            raise GatewayError(f"{url}: a collector's URL is http://HOST:PORT or https://HOST:PORT")
        self._url = f"{url.rstrip('/')}/{topic(car.name, car.car, 'events')}"
        self._context: ssl.SSLContext | None = None
        if url.startswith("https:"):
            try:
                self._context = ssl.create_default_context(cafile=broker.ca)
                if broker.certificate is not None:
                    self._context.load_cert_chain(broker.certificate, broker.key)
            except OSError as error:
                raise GatewayError(f"{url}: {error}") from error

    async def send(self, payload: bytes, wait_s: float) -> bool:
        """Post a batch; returns whether the collector has it."""
        done = await asyncio.to_thread(self._post, payload, min(wait_s, 60.0))
        if not done:
            await asyncio.sleep(random.uniform(0.0, min(wait_s, LONGEST_S) / FIRST_S))
        return done

    def _post(self, payload: bytes, wait_s: float) -> bool:
        request = urllib.request.Request(self._url, payload, {"Content-Type": "application/octet-stream"})  # noqa: S310 - http only, see above
        try:
            with urllib.request.urlopen(request, timeout=wait_s, context=self._context) as answer:  # noqa: S310
                return digest_in(answer.read(1 << 16)) == digest_of(payload)
        except (OSError, urllib.error.HTTPError) as error:
            log.info("the collector is not reached; it is tried again", url=self._url, reason=str(error))
            return False
