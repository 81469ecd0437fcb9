"""The J1939 server: DM1 by itself, the other diagnostic messages on request."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.faults.dtc import ALL_DTCS
from gateway.faults.entries import DtcChange
from gateway.faults.interventions import DONE, Intervention
from gateway.faults.memory import FaultMemory
from gateway.faults.store import StoreError
from gateway.j1939.frame import GLOBAL
from gateway.servers.authority import SESSIONLESS_ASKER, Authority, Refusal
from gateway.servers.bus_server import BusServer
from gateway.servers.tester_control import TesterControl
from gateway_testers.j1939 import messages as dm
from gateway_testers.j1939.answers import Answers
from gateway_testers.j1939.dm1 import Dm1Schedule
from gateway_testers.j1939.dtcs import CodedDtcs
from gateway_testers.j1939.endpoint import DENIED, MASKS, NEGATIVE, POSITIVE, J1939Endpoint, PgnRequest
from gateway_testers.j1939.params import J1939Params


class J1939Server(BusServer):
    """Sends DM1 and answers requests at an address of its own.

    Args:
        params: settings.
        endpoint: the address, with the sessions of its transport protocol.
        memory: the fault memory.
        control: the gateway.
        authority: says whether DM3 and DM11 may clear.
        bus: name of its bus.
    """

    prompt = True
    door = "j1939"

    def __init__(
        self,
        params: J1939Params,
        endpoint: J1939Endpoint,
        memory: FaultMemory,
        control: TesterControl,
        authority: Authority,
        bus: str = "",
    ) -> None:
        self._bus = bus
        self._authority = authority
        self.endpoint, self.masks = endpoint, MASKS
        self._control = control
        self._dtcs = CodedDtcs(memory)
        self._answers = Answers(params, memory, self._dtcs)
        self._dm1 = Dm1Schedule(params, self._dtcs)

    def succeed(self, old: BusServer, buses: Mapping[int, int]) -> None:
        """Keep the address, the sessions of the transport protocol, and the record of DTCs that were told."""
        if isinstance(old, J1939Server) and self.endpoint.succeed(old.endpoint, buses.get(old.endpoint.bus)):
            self._dm1.succeed(old._dm1)

    def restart(self) -> None:
        """Drop the messages of several frames that are under way."""
        self.endpoint.restart()

    def identifiers(self, bus: int) -> list[int] | None:
        """Any sender on its bus may mean it."""
        return None if bus == self.endpoint.bus else []

    def wanted(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames are of its protocols and for its address, or for all."""
        return self.endpoint.wanted(frames)

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take a frame; answers the request that it completes."""
        request = self.endpoint.receive(frame, t_ns)
        while self.endpoint.commanded:
            source, command = self.endpoint.commanded.pop()
            self._control.note(Intervention(0, "j1939", self._bus, source, "address", command))
        if request is not None:
            self._answer(request)
        return self.endpoint.take_frames()

    def _answer(self, request: PgnRequest) -> None:
        if request.pgn in (dm.DM3, dm.DM11):
            kind = self._clear(request.pgn)
            self._note(request, kind)
            self.endpoint.acknowledge(kind, request)
            return
        data = self._answers.of(request.pgn)
        if data is None:
            self.endpoint.acknowledge(NEGATIVE, request)
        else:
            self.endpoint.answer(request, data)

    def _note(self, request: PgnRequest, kind: int) -> None:
        refused = {POSITIVE: DONE, DENIED: Refusal.SECURITY, NEGATIVE: Refusal.CONDITIONS}
        pgn = request.pgn.to_bytes(3, "big")
        by = Intervention(0, "j1939", self._bus, request.source, "j1939_clear", pgn, refused[kind])
        self._control.note(by)

    def _clear(self, pgn: int) -> int:
        """Clear all DTCs (DM11), or those that were active (DM3); returns how to acknowledge it."""
        refusal = self._authority.refusal("j1939_clear", SESSIONLESS_ASKER)
        if refusal:
            return NEGATIVE if refusal == Refusal.CONDITIONS else DENIED
        try:
            if pgn == dm.DM11:
                self._control.clear(ALL_DTCS)
            else:
                for _, entry in self._dtcs.previous():
                    self._control.clear(entry.dtc.value)
        except StoreError:  # faults that were not cleared durably are still there
            return NEGATIVE
        return POSITIVE

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Note DTCs that changed; :meth:`on_time` sends them."""
        self._dm1.note(changes)
        return empty(0)

    def on_time(self, t_ns: int) -> Frames:
        """Claim, send what is due of longer messages, and DM1."""
        now = self.endpoint.pass_time(t_ns)
        active = self._dm1.take_due(now) if self.endpoint.claimed else None
        if active is not None:
            self.endpoint.send(dm.DM1, self._answers.with_lamps(active), GLOBAL)
        return self.endpoint.take_frames()

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`on_time` has something to do."""
        at = self.endpoint.next_ns
        return min(at, self._dm1.next_ns) if self.endpoint.claimed else at

    def counters(self) -> dict[str, int]:
        """Return what the transport protocol counted."""
        return self.endpoint.counters()
