"""``gateway record``: frames into a file, or into a ring of segments."""

from __future__ import annotations

import signal
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from gateway.bus.logs import open_writer
from gateway.bus.ring import Ring, RingParams
from gateway.bus.uri import channel_of, open_bus
from gateway.cli.events import EventPrinter
from gateway.cli.present import say
from gateway.cli.run import Ending
from gateway.live.clock import Clock
from gateway.live.link import Link, bus_event
from gateway.live.loop import Live
from gateway.live.notify import Notifier
from gateway_commands.recording import Nobody
from gateway_fdi.common.tomlfile import validate
from gateway_fdi.errors import InputError, InputErrors


def record(
    uris: list[str],
    *,
    out: Path | None,
    ring: Path | None,
    keep_mb: float,
    segment_mb: float,
    form: str,
    duration: float | None,
    json: bool,
) -> int:
    """Record until told to stop; returns the exit code."""
    if (out is None) == (ring is None):
        raise InputError("say where to: a file with --out, or a folder with --ring")
    ending = Ending().after(duration)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    channels = _channels(uris)
    printer = EventPrinter(as_json=json, start_ns=time.time_ns())
    clock = Clock()
    nobody, notifier = Nobody(printer), Notifier()
    with ExitStack() as stack:
        sink: Ring | None = None
        if ring is not None:
            asked = {"folder": ring, "keep_mb": keep_mb, "segment_mb": segment_mb, "format": form}
            sink = Ring(validate(asked, RingParams, None), channels)
            stack.callback(sink.close)
        writer = None if out is None else stack.enter_context(open_writer(out, interfaces=channels))
        links = []
        for index, uri in enumerate(uris):
            opener = partial(open_bus, patience_s=0.0)
            links.append(Link(uri, index, channels[index], opener, clock))
            stack.callback(links[-1].close)
            links[-1].start()
        taps = [tap for tap in (sink, writer) if tap is not None]
        live = Live(nobody, links, printer, taps=taps, clock=clock)
        say(f"recording {', '.join(uris)} to {out or ring}")
        notifier.ready(f"recording {', '.join(uris)}")
        live.run(ending, on_turn=notifier.alive)
        notifier.stopping()
        for link in links:
            printer(bus_event(link, "closed", clock.wall()))
    lost = 0 if sink is None else sink.lost
    say(f"{nobody.frames} frames recorded" + (f", {lost} could not be written" if lost else ""))
    if writer is not None and writer.problems:
        raise InputErrors(writer.problems)
    return 0


def _channels(uris: list[str]) -> dict[int, str]:
    """Return the names of the buses in the recording: those of the interfaces, where they differ."""
    names = [channel_of(uri) for uri in uris]
    if len(set(names)) < len(names):
        names = [f"can{k}" for k in range(len(uris))]
    return dict(enumerate(names))
