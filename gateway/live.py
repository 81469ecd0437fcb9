"""The live loop: buses are readable, time passes, frames leave. The only reader of the wall clock."""

from __future__ import annotations

import selectors
import time
from collections.abc import Callable, Sequence

import numpy as np
import structlog

from gateway.app import Gateway
from gateway.bus.base import Bus
from gateway.bus.frames import Frames, empty
from gateway.bus.logs import LogWriter
from gateway.errors import BusError

#: Frames taken from a bus at one readable event.
BATCH = 256
#: Without traffic, time is let pass this far behind the clock, so that a frame that is still on its
#: way through the kernel is not overtaken by the timers it would have stopped.
GRACE_NS = 20_000_000
#: Longest wait for a bus: how late a timer may run without traffic.
TICK_S = 0.01
#: How often requests of other processes are looked for.
POLL_S = 0.1

log = structlog.get_logger(__name__)


def run_live(
    gateway: Gateway,
    buses: Sequence[Bus],
    stop: Callable[[], bool],
    *,
    record: LogWriter | None = None,
    clock_ns: Callable[[], int] = time.time_ns,
    tick_s: float = TICK_S,
) -> None:
    """Feed a gateway from its buses until told to stop.

    Args:
        gateway: started already.
        buses: in the order of their indices.
        stop: asked after every batch and every tick.
        record: takes each frame exactly as the engine gets it.
        clock_ns: the clock that stamps the frames of these buses [ns].
        tick_s: longest wait without traffic [s].

    Raises:
        BusError: a bus failed.
    """
    batch = empty(BATCH)
    poll = 0.0
    with selectors.DefaultSelector() as selector:
        for bus in buses:
            selector.register(bus.fileno(), selectors.EVENT_READ, bus)
        while not stop():
            soon = (gateway.next_ns - clock_ns()) / 1e9
            ready = selector.select(min(tick_s, max(soon, 0.0)))
            for key, _ in ready:
                bus = key.data
                count = BATCH
                while count == BATCH:
                    count = bus.receive(batch)
                    if not count:
                        break
                    frames = batch[:count]
                    if record is not None:
                        record.write(frames)
                    send(buses, gateway.feed(frames))
            if not ready:
                # Only now: frames that still wait in a queue must not be overtaken. With traffic,
                # its own time stamps move the clock.
                send(buses, gateway.advance(clock_ns() - GRACE_NS))
            send(buses, gateway.poll(clock_ns()))
            if time.monotonic() >= poll:
                gateway.serve_requests()
                poll = time.monotonic() + POLL_S


def send(buses: Sequence[Bus], frames: Frames) -> None:
    """Send frames on the buses they name; a bus that cannot take them is logged, not fatal."""
    for index in np.unique(frames["bus"]) if len(frames) else ():
        try:
            buses[int(index)].send(frames[frames["bus"] == index])
        except BusError as error:
            log.warning("frames not sent", bus=buses[int(index)].uri, error=str(error))
