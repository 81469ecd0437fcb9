"""The vehicle's memory in the gateway: DTCs of other ECUs are kept, told, and tested as faults of ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.config.model import Config
from gateway.engine.core import Engine, Sink
from gateway.faults.entries import DtcChange
from gateway.faults.memory import FaultMemory
from gateway.faults.status import Status
from gateway.faults.vehicle import TOLD, DtcAnswer, EcuDtc
from gateway.servers.bus_server import BusServer
from gateway_ask.clients.ask import PROBES
from gateway_ask.clients.poller import TELLS, Ecu, Poller


class Vehicle(BusServer):
    """Takes what answers tell of DTCs, right behind the frame that completes each.

    Args:
        config: the configuration.
        asking: hears the answers.
        memory: keeps the DTCs.
        engine: debounces the faults that stand for some of them.
    """

    def __init__(self, config: Config, asking: Poller, memory: FaultMemory, engine: Engine) -> None:
        self._first, self._asking, self._memory, self._engine = len(config.bus), asking, memory, engine
        places = {slot.id: k for k, slot in enumerate(engine.faults)}
        self._faults: dict[str, list[tuple[str, int]]] = {}
        for ecu in config.ecu:
            self._faults[ecu.name] = [(fault.of, places[f"{ecu.name}.{fault.name}"]) for fault in ecu.fault]
        for each in asking.ecus:
            self._remember(each)
        self._note: Callable[[dict[str, Any]], None] = lambda _event: None
        self._sink: Sink = lambda _events: None

    def _remember(self, ecu: Ecu) -> None:
        """Have an ECU asked first by the protocol that it answered, and kept what it answers."""
        names, place = ["", *PROBES], ecu.client.place
        key = f"{ecu.client.bus}.{place.request:X}.{place.response:X}"
        kept = self._memory.spoken(key)
        ecu.client.expect(
            names[kept] if 0 < kept < len(names) else "",
            lambda protocol: self._memory.keep_spoken(key, names.index(protocol)),
        )

    def connect(self, note: Callable[[dict[str, Any]], None], sink: Sink) -> None:
        """Say who tells events when they are stored, and who takes the engine's."""
        self._note, self._sink = note, sink

    def identifiers(self, bus: int) -> list[int] | None:
        """Return the identifier of the frames that :class:`Poller` puts behind such answers."""
        return [TELLS] if bus >= self._first else []

    def wanted(self, frames: Frames) -> NDArray[np.bool_] | None:
        """Return which frames are such ones."""
        return np.asarray((frames["can_id"] == TELLS) & (frames["bus"] >= self._first), np.bool_)

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take what the answer tells."""
        told = self._asking.told.popleft()
        now_ns = self._engine.wall_ns(int(frame["t_ns"]))
        for dtc, state in self._memory.ledger.note_ecu_dtcs(told, now_ns):
            self._note(ecu_dtc_event(dtc, state, now_ns))
            if state == "came":
                self._asking.on_dtc(told.ecu, t_ns)
        self._test(told)
        return empty(0)

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Have that asked which is asked when a DTC came: one of ours begins to fail."""
        if any(one.new_status & ~one.old_status & Status.TEST_FAILED for one in changes):
            self._asking.on_dtc(None, t_ns)
        return empty(0)

    def _test(self, told: DtcAnswer) -> None:
        """Report the faults that stand for DTCs of which the answer speaks."""
        known = {each.dtc: each for each in self._memory.vehicle.all() if each.ecu == told.ecu}
        for of, place in self._faults.get(told.ecu, ()):
            # A code without a failure type stands for all that begin so.
            mine = [each for each in known.values() if each.dtc == of or each.dtc[:5] == of]
            there = any(each.there for each in mine)
            if there or told.covers & TOLD:
                self._engine.report(place, there, float(there), 0.0, (), self._sink)

    def counters(self) -> dict[str, int]:
        """Return how many DTCs there was no room for."""
        dropped = self._memory.vehicle.dropped
        return {"ecu_dtcs_dropped": dropped} if dropped else {}


def ecu_dtc_event(dtc: EcuDtc, state: str, t_ns: int) -> dict[str, Any]:
    """Tell a DTC of another ECU that came, changed or went."""
    return {"event": "ecu_dtc", "t_ns": t_ns, "ecu": dtc.ecu, "dtc": dtc.dtc, "state": state, "status": dtc.status}
