"""A scenario and a gateway in one process, over python-can's virtual bus: demo, CI, tests.

Simulated time: frames carry the scenario's clock, and each step's frames have all arrived before the next
step begins, so a run is the same every time and goes as fast as the machine allows.
"""

from __future__ import annotations

import itertools
import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

from gateway.bus.base import Bus
from gateway.bus.frames import Frames, empty
from gateway.bus.uri import open_bus
from gateway.common.resources import shipped
from gateway.config.model import Config
from gateway.errors import BusError, InputError
from gateway.runtime.app import Gateway
from gateway.servers.dtc_frame import DtcReport, read_dtc_frame
from gateway.vecu.expectations import Judge
from gateway.vecu.player import Player
from gateway.vecu.scenario import Scenario

#: Longest wait for frames that were sent already [s].
PATIENCE_S = 10.0

_names = itertools.count()


def collect(bus: Bus, count: int) -> Frames:
    """Wait for exactly so many frames of a bus.

    Raises:
        BusError: they did not come in time.
    """
    parts: list[Frames] = []
    missing = count
    while missing:
        if not select.select([bus.fileno()], [], [], PATIENCE_S)[0]:
            raise BusError(f"{bus.uri}: {missing} of {count} frames did not arrive")
        batch = empty(missing)
        got = bus.receive(batch)
        parts.append(batch[:got])
        missing -= got
    return np.concatenate(parts) if parts else empty(0)


class _Wires:
    """The virtual buses of a configuration, with three ends each: the ECUs', the gateway's and a tester's.

    Args:
        gateway: whose configuration it is.
    """

    def __init__(self, gateway: Gateway) -> None:
        uris = [f"virtual:{bus.name}-{os.getpid()}-{next(_names)}" for bus in gateway.config.bus]
        self._dtc_frame_id = gateway.dtc_frame_id
        self._database = shipped("dbc/gateway.dbc")
        self._ecus, self._ours, self._testers = (
            [open_bus(uri, index) for index, uri in enumerate(uris)] for _ in range(3)
        )
        for bus in self._ecus:
            bus.set_filters([0x1FFFFFFF | 0x80000000])  # virtual ECUs listen to nobody
        for bus in self._testers:
            bus.set_filters([gateway.dtc_frame_id])

    def carry(self, frames: Frames) -> Frames:
        """Send frames from the ECUs; returns them as the gateway got them, in order of time."""
        if not len(frames):
            return frames
        arrived = []
        for index, (ecu, ours) in enumerate(zip(self._ecus, self._ours, strict=True)):
            mine = frames[frames["bus"] == index]
            ecu.send(mine)
            arrived.append(collect(ours, len(mine)))
        batch = np.concatenate(arrived)
        return batch[np.argsort(batch["t_ns"], kind="stable")]

    def reports(self, frames: Frames) -> Iterator[DtcReport]:
        """Send frames from the gateway, bus by bus; yields the DTC frames among them as a tester decodes them."""
        if not len(frames):
            return
        for index, (ours, tester) in enumerate(zip(self._ours, self._testers, strict=True)):
            mine = frames[frames["bus"] == index]
            ours.send(mine)
            dtc = mine["can_id"] == self._dtc_frame_id
            for frame in collect(tester, int(dtc.sum())):
                report = read_dtc_frame(frame, self._database)
                if report is not None:
                    yield report

    def close(self) -> None:
        """Close all ends."""
        for bus in (*self._ecus, *self._ours, *self._testers):
            bus.close()


class Driven(Protocol):
    """What a scenario is played to: a gateway."""

    def feed(self, frames: Frames) -> Frames:
        """Take a batch; returns the frames to send."""

    def advance(self, t_ns: int) -> Frames:
        """Let time pass; returns the frames to send."""

    def stop(self, t_ns: int) -> None:
        """End the operation cycle."""


def judgeable(scenario: Scenario, config: Config, *, file: Path) -> None:
    """Refuse to judge a scenario whose gateway tells no tester of its DTCs: each expectation of silence would hold.

    Args:
        scenario: with expectations.
        config: of the gateway.
        file: of the scenario.

    Raises:
        InputError: the configuration has no DTC frame.
    """
    if config.output.dtc_frame is None:
        text = "expectations are judged by the gateway's DTC frame: its configuration needs [output.dtc_frame]"
        raise InputError(text, file=file, key="config", value=str(scenario.config))


def drive(
    gateway: Gateway,
    player: Player,
    *,
    judge: Judge | None = None,
    on_frames: Callable[[Frames], None] | None = None,
    on_report: Callable[[DtcReport], None] | None = None,
    on_step: Callable[[int], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
    fed: Driven | None = None,
) -> None:
    """Play a scenario to a gateway and read its DTC frames as a tester would.

    Args:
        gateway: not started yet.
        player: of the scenario.
        judge: takes the reports.
        on_frames: called with each step's frames as the gateway got them.
        on_report: called with each DTC frame, decoded.
        on_step: called at the end of each step with its time [ns].
        stop: tells to end early; the operation cycle ends then.
        fed: what is fed instead of the gateway; it feeds the gateway.
    """
    driven: Driven = gateway if fed is None else fed
    wires = _Wires(gateway)
    try:
        gateway.start(0)
        until = 0
        for until, frames in player.batches():
            if stop():
                break
            batch = wires.carry(frames)
            if on_frames is not None:
                on_frames(batch)
            for sent in (driven.feed(batch), driven.advance(until)):
                player.hear(sent)
                for report in wires.reports(sent):
                    if judge is not None and report.dtc is not None:
                        judge.report(report.t_ns / 1e9, str(report.dtc), report.status, report.occurrence)
                    if on_report is not None:
                        on_report(report)
            if on_step is not None:
                on_step(until)
        driven.stop(until)
    finally:
        player.close()
        wires.close()
