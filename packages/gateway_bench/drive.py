"""A scenario and a gateway in one process: demo, CI, tests.

Simulated time: frames carry the scenario's clock, and each step's frames have all arrived before the next
step begins, so a run is the same every time and goes as fast as the machine allows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from gateway.bus.frames import Frames
from gateway.config.model import Config
from gateway.runtime.app import Gateway
from gateway.servers.dtc_frame import DtcReport, message_of, read_dtc_frame
from gateway_bench.vecu.expectations import Judge
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import Scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError


class Driven(Protocol):
    """Receiver of a scenario: a gateway."""

    def feed(self, frames: Frames) -> Frames:
        """Take a batch; returns the frames to send."""

    def advance(self, t_ns: int) -> Frames:
        """Let time pass; returns the frames to send."""

    def stop(self, t_ns: int) -> None:
        """End the operation cycle."""


def judgeable(scenario: Scenario, config: Config, *, file: Path) -> None:
    """Refuse to judge a gateway on a bus that tells no tester of its DTCs: each expectation of silence would hold.

    Raises:
        InputError: the configuration has no DTC frame.
    """
    if config.output.dtc_frame is None:
        text = "expectations are judged by the gateway's DTC frame: its configuration needs [output.dtc_frame]"
        raise InputError(text, file=file, key="config", value=str(scenario.config))


def arriving(frames: Frames) -> Frames:
    """Return a step's frames as a gateway gets them: in order of time, those of one time bus by bus."""
    return frames[np.lexsort((frames["bus"], frames["t_ns"]))]


#: Database of the DTC frame. It is looked for once: each step of a drive asks for it.
_database = cache(partial(shipped, "dbc/gateway.dbc"))


def reports_among(frames: Frames) -> Iterator[DtcReport]:
    """Yield the DTC frames of a gateway as a tester decodes them."""
    database = _database()
    for frame in frames[frames["can_id"] == message_of(database).frame_id]:
        report = read_dtc_frame(frame, database)
        if report is not None:
            yield report


def _judged(judge: Judge, event: dict[str, Any]) -> None:
    """Judge the event of a DTC."""
    if event["event"] == "dtc":
        judge.report(event["t_ns"] / 1e9, event["dtc"], event["status"], event["occurrence"])


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
    """Play a scenario to a gateway and read its DTC frames as a tester would; its events, if it sends no DTC frames.

    Args:
        gateway: not started yet.
        player: of the scenario.
        judge: takes the reports.
        on_frames: called with each step's frames as the gateway got them.
        on_report: called with each DTC frame, decoded.
        on_step: called at the end of each step with its time [ns].
        stop: tells to end early; the operation cycle ends then.
        fed: is fed instead of the gateway, and feeds it.
    """
    driven: Driven = gateway if fed is None else fed
    if judge is not None and gateway.config.output.dtc_frame is None:
        gateway.listen(partial(_judged, judge))
    try:
        gateway.start(0)
        until = 0
        for until, frames in player.batches():
            if stop():
                break
            batch = arriving(frames)
            if on_frames is not None:
                on_frames(batch)
            # Clients ask by the clock of the frames' stamps, which here is the scenario's.
            given = [driven.feed(batch)] if len(batch) else []  # of a slow plant most steps have no frame
            for sent in (*given, driven.advance(until), gateway.asking.poll(until)):
                player.hear(sent)
                for report in reports_among(sent):
                    if judge is not None and report.dtc is not None:
                        judge.report(report.t_ns / 1e9, str(report.dtc), report.status, report.occurrence)
                    if on_report is not None:
                        on_report(report)
            if on_step is not None:
                on_step(until)
        driven.stop(until)
    finally:
        player.close()
