"""DTC frames: message GW_DTC of dbc/gateway.dbc, at each change and cyclically."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray
from pydantic import Field

from gateway.bus.frames import FRAME, URGENT, Frames, empty, payload
from gateway.faults.dtc import Dtc
from gateway.faults.entries import DtcChange
from gateway.faults.memory import FaultMemory
from gateway.servers.bus_server import BusServer
from gateway.servers.prepared_frames import PreparedFrames
from gateway.servers.prepared_frames_kernel import put_report
from gateway.signals.database import load_database
from gateway_fdi.common.log import get_logger
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.jit import bound

MESSAGE = "GW_DTC"
_CELLS = FRAME.itemsize // 8

log = get_logger(__name__)


class DtcFrameParams(StrictModel):
    """Settings of the DTC frame."""

    bus: str | None = Field(None, description="name of the bus it is sent on")
    cycle_ms: float = Field(1000.0, ge=10, allow_inf_nan=False, description="time between two cyclic lists [ms]")
    status_mask: int = Field(0x0D, ge=1, le=0xFF, description="DTCs with any of these status bits are in the list")
    min_interval_ms: float = Field(
        10.0,
        ge=0,
        allow_inf_nan=False,
        description="least time between two change frames of one DTC [ms]",
    )


@cache
def message_of(database: Path) -> Message:
    """Return the message from its database."""
    return load_database([database]).message(MESSAGE)


@dataclass(frozen=True)
class DtcReport:
    """Contents of one DTC frame; ``dtc`` is None in the all-clear form."""

    t_ns: int
    dtc: Dtc | None
    status: int
    fdc: int
    index: int
    count: int
    occurrence: int


def read_dtc_frame(frame: np.void, database: Path) -> DtcReport | None:
    """Decode a DTC frame as a tester does, with cantools; None for any other frame."""
    message = message_of(database)
    if int(frame["can_id"]) != message.frame_id or int(frame["length"]) < message.length:
        return None
    values = cast(Any, message.decode(payload(frame), decode_choices=False))
    number = int(values["Dtc"])
    return DtcReport(
        int(frame["t_ns"]),
        Dtc(number) if number else None,
        int(values["Status"]),
        int(values["FaultDetectionCounter"]),
        int(values["Index"]),
        int(values["Count"]),
        int(values["Occurrence"]),
    )


class DtcFrameSender(BusServer):
    """Sends the DTC frames, driven by the time it is given; it listens to nothing.

    Args:
        params: settings.
        database: dbc/gateway.dbc.
        bus: index of the bus.
        memory: the fault memory.
        counter_of: fault id -> its fault detection counter now.

    Attributes:
        foretold: the frames that are told before their changes come.
    """

    urgent = True

    def __init__(
        self,
        params: DtcFrameParams,
        database: Path,
        bus: int,
        memory: FaultMemory,
        counter_of: Callable[[str], int],
    ) -> None:
        self._params = params
        self._memory = memory
        self._next_ns: int | None = None
        self._held: dict[str, DtcChange] = {}
        self._sent_ns: dict[str, int] = {}
        self._counter_of = counter_of
        self.prepared = PreparedFrames(message_of(database), bus, memory, params.status_mask)
        self._corrected = 0
        example = np.zeros(_CELLS, np.uint64)
        self._put = bound(put_report, self.prepared.tables, rest=(example, 0, 0, 0, 0, 0, 0, 0))

    def succeed(self, old: BusServer, buses: Mapping[int, int]) -> None:
        """Tell the changes that were held back, and go on with the cyclic list."""
        if isinstance(old, DtcFrameSender):
            known = self._memory.catalogue.get
            self._held = {name: held for name, held in old._held.items() if known(name) is not None}
            self.prepared.succeed(old.prepared)
            for name, at in old._sent_ns.items():
                self._note_sent(name, at)
            if self._params.cycle_ms == old._params.cycle_ms:
                self._next_ns = old._next_ns

    @property
    def next_ns(self) -> int:
        """When a held change or the cyclic list is due."""
        if self._next_ns is None:
            return 0
        interval = round(self._params.min_interval_ms * 1e6)
        held = [self._sent_ns.get(name, -interval) + interval for name in self._held]
        return min([self._next_ns, *held])

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Return the frames for changes that are durable.

        A DTC that chatters is sent at most once in ``min_interval_ms``, its latest state always.
        """
        memory = self._memory
        for change in changes:
            self._held[change.definition.id] = change
        interval = self._params.min_interval_ms * 1e6
        due = [
            change
            for name, change in self._held.items()
            if name not in self._sent_ns or t_ns - self._sent_ns[name] >= interval
        ]
        if not due:
            return empty(0)
        count = memory.count_by_status_mask(self._params.status_mask)
        frames, cells = self._room(len(due))
        for k, change in enumerate(due):
            name = change.definition.id
            del self._held[name]
            self._note_sent(name, t_ns)
            # A change that had to wait may be outdated by a clear or a new operation cycle.
            dtc, status, occurrence = memory.state(name)
            fdc = change.fdc if status == change.new_status else self._counter_of(name)
            self._put(cells[k], t_ns, dtc, status, fdc, 0, count, occurrence)
        if not self.prepared.gone:
            return frames
        names = [change.definition.id for change in due]
        return frames[[k for k, name in enumerate(names) if self.prepared.take(name) != payload(frames[k])]]

    def _note_sent(self, name: str, t_ns: int) -> None:
        self._sent_ns[name] = t_ns
        self.prepared.wait(name, t_ns + round(self._params.min_interval_ms * 1e6))

    def correct(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Return frames for DTCs that were told otherwise than they have become: it must not be.

        Args:
            changes: of the verdicts that were foretold.
            t_ns: now [ns].
        """
        names = self.prepared.take_wrong(changes)
        if not names:
            return empty(0)
        self._corrected += len(names)
        log.error("a DTC was told before its verdict was entered, and not as it became; it is told again", faults=names)
        frames, cells = self._room(len(names))
        count = self._memory.count_by_status_mask(self._params.status_mask)
        for k, name in enumerate(names):
            dtc, status, occurrence = self._memory.state(name)
            self._put(cells[k], t_ns, dtc, status, self._counter_of(name), 0, count, occurrence)
        frames["rank"] = URGENT
        return frames

    def counters(self) -> dict[str, int]:
        """Return how many DTC frames had to be corrected."""
        return {"dtc_frames_corrected": self._corrected}

    # Time

    def on_time(self, t_ns: int) -> Frames:
        """Return changes that were held back, and the cyclic list when it is due."""
        return np.concatenate([self.on_changes([], t_ns), self._list(t_ns)])

    def _list(self, t_ns: int) -> Frames:
        memory = self._memory
        if self._next_ns is not None and t_ns < self._next_ns:
            return empty(0)
        cycle = round(self._params.cycle_ms * 1e6)
        late = self._next_ns is None or t_ns - self._next_ns > cycle
        self._next_ns = t_ns + cycle if late or self._next_ns is None else self._next_ns + cycle
        entries = memory.by_status_mask(self._params.status_mask)
        frames, cells = self._room(max(len(entries), 1))
        if not entries:
            self._put(cells[0], t_ns, 0, 0, 0, 0, 0, 0)
        for k, entry in enumerate(entries):
            kept, counter = entry.record, self._counter_of(entry.fault)
            self._put(cells[k], t_ns, kept.dtc, kept.status, counter, k + 1, len(entries), kept.occurrence)
        return frames

    @staticmethod
    def _room(count: int) -> tuple[Frames, NDArray[np.uint64]]:
        """Return frames to be filled, and the same in cells."""
        frames = empty(count)
        return frames, frames.view(np.uint64).reshape(count, _CELLS)
