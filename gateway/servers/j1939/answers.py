"""What is answered to requests for diagnostic messages (SAE J1939-73): from the fault memory to bytes."""

from __future__ import annotations

from collections.abc import Callable

from gateway.faults.memory import FaultMemory
from gateway.faults.readiness import readiness
from gateway.faults.status import Status
from gateway.servers.j1939 import messages as dm
from gateway.servers.j1939.dtcs import CodedDtcs
from gateway.servers.j1939.params import J1939Params


class Answers:
    """The diagnostic messages that can be asked for; none of them changes anything.

    Args:
        params: settings.
        memory: the fault memory.
        dtcs: its DTCs that J1939 tells of.
    """

    def __init__(self, params: J1939Params, memory: FaultMemory, dtcs: CodedDtcs) -> None:
        self._params = params
        self._memory = memory
        self._dtcs = dtcs
        self._makers: dict[int, Callable[[], bytes]] = {
            dm.DM1: lambda: self.with_lamps(dtcs.active()),
            dm.DM2: lambda: self.with_lamps(dtcs.previous()),
            dm.DM5: self._readiness,
            dm.DM6: lambda: self.with_lamps(dtcs.pending()),
            dm.DM12: lambda: self.with_lamps([c for c in dtcs.active() if c[0].emission_related]),
            dm.DM24: lambda: dm.spn_support(params.freeze_frame),
            dm.DM25: self._freeze_frames,
            dm.DM28: lambda: self.with_lamps(dtcs.permanent()),
        }

    def of(self, pgn: int) -> bytes | None:
        """Return the message of a parameter group as it is now; None: there is none."""
        maker = self._makers.get(pgn)
        return None if maker is None else maker()

    def with_lamps(self, dtcs: list[dm.Coded]) -> bytes:
        """Return the lamps, which stand for all DTCs, and these DTCs."""
        lit = {definition.lamp for definition, entry in self._dtcs.all() if entry.status & Status.WARNING_INDICATOR}
        return dm.dtc_message(dm.lamp_bytes(lit, self._params.lamps), dtcs)

    def _readiness(self) -> bytes:
        return dm.readiness_message(
            len(self._dtcs.active()),
            len(self._dtcs.previous()),
            self._params.obd_compliance,
            readiness(self._memory),
        )

    def _freeze_frames(self) -> bytes:
        frames = [(coded, frame.content) for coded in self._dtcs.all() for frame in coded[1].freeze_frames]
        return dm.freeze_frames(frames, self._params.freeze_frame)
