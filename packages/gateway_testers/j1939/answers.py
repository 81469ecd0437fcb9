"""Answers to requests for diagnostic messages (SAE J1939-73): from the fault memory to bytes."""

from __future__ import annotations

from collections.abc import Callable

from gateway import __version__
from gateway.faults.catalogue import MIL
from gateway.faults.memory import FaultMemory
from gateway.faults.status import Status
from gateway_testers.j1939 import messages as dm
from gateway_testers.j1939.dtcs import CodedDtcs
from gateway_testers.j1939.params import J1939Params
from gateway_testers.readiness import readiness


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
            dm.DM21: lambda: dm.driven(memory.usage.driven()),
            dm.DM24: lambda: dm.spn_support(params.freeze_frame),
            dm.DM25: self._freeze_frames,
            dm.DM26: lambda: dm.readiness_of_cycle(readiness(memory, this_cycle=True)),
            dm.DM28: lambda: self.with_lamps(dtcs.permanent()),
            dm.DM29: self._counts,
            dm.SOFTWARE: self._software,
        }
        if params.calibration is not None:
            given = params.calibration_check, params.calibration
            self._makers[dm.DM19] = lambda: dm.calibration(*given)
        counted = memory.performance
        if counted.offered:
            self._makers[dm.DM20] = lambda: dm.performance(
                counted.ignition_cycles, counted.conditions, counted.by_group()
            )
        if params.component is not None:
            texts = params.component.make, params.component.model, params.component.serial, params.component.unit
            self._makers[dm.COMPONENT] = lambda: dm.identification(*texts)
        if params.vin is not None:
            vin = params.vin
            self._makers[dm.VIN] = lambda: dm.identification(vin)

    def of(self, pgn: int) -> bytes | None:
        """Return the message of a parameter group as it is now; None: there is none."""
        maker = self._makers.get(pgn)
        return None if maker is None else maker()

    def with_lamps(self, dtcs: list[dm.Coded]) -> bytes:
        """Return the lamps, which stand for all DTCs, and these DTCs."""
        lit = {definition.lamp for definition, entry in self._dtcs.all() if entry.status & Status.WARNING_INDICATOR}
        return dm.dtc_message(dm.lamp_bytes(lit, self._params.lamps), dtcs)

    def _software(self) -> bytes:
        texts = self._params.software or (f"gateway {__version__}",)
        return bytes([len(texts)]) + dm.identification(*texts)

    def _counts(self) -> bytes:
        """Count DTCs; those with the MIL are emission related, and ask for the lamp malfunction."""
        pending = self._dtcs.pending()
        mil = [c for c in self._dtcs.all() if c[0].emission_related and c[0].indicator and c[0].lamp == MIL]
        lit = sum(1 for _, entry in mil if entry.status & Status.WARNING_INDICATOR)
        confirmed = sum(1 for _, entry in mil if entry.status & Status.CONFIRMED_DTC)
        related = sum(1 for definition, _ in pending if definition.emission_related)
        return dm.counts(related, len(pending), lit, confirmed - lit, len(self._dtcs.permanent()))

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
