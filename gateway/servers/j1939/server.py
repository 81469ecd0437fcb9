"""The J1939 output: DM1 by itself, the other diagnostic messages on request."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import ERROR, EXTENDED, REMOTE, Frames, empty
from gateway.faults.dtc import ALL_DTCS
from gateway.faults.entries import DtcChange, Entry
from gateway.faults.memory import FaultMemory
from gateway.faults.readiness import readiness
from gateway.faults.status import Status
from gateway.faults.store import StoreError
from gateway.servers.base import Output
from gateway.servers.control import Control
from gateway.servers.j1939 import messages as dm
from gateway.servers.j1939.claim import Claim
from gateway.servers.j1939.frame import (
    ACKNOWLEDGMENT,
    ADDRESS_CLAIMED,
    GLOBAL,
    REQUEST,
    TP_CM,
    TP_DT,
    Pdu,
    pgn_bytes,
    read_pdu,
    to_frames,
)
from gateway.servers.j1939.params import J1939Params
from gateway.servers.j1939.transport import Transport

_POSITIVE, _NEGATIVE, _DENIED = 0, 1, 2
#: Least time between two messages for changes of one DTC (J1939-73, DM1).
_CHANGE_NS = 1_000_000_000
#: Not active, and long ago.
_NEVER_TOLD = (False, -_CHANGE_NS)


class J1939Output(Output):
    """Sends DM1, answers requests, keeps an address.

    Active are confirmed DTCs whose test fails; previously active those whose test does not any more.

    Args:
        params: settings.
        bus: index of the bus.
        memory: the fault memory.
        control: the gateway.
    """

    prompt = True

    def __init__(
        self, params: J1939Params, bus: int, memory: FaultMemory, control: Control
    ) -> None:
        self._params = params
        self._bus = bus
        self._memory = memory
        self._control = control
        self._claim = Claim(params.name, params.address)
        self.transport = Transport(params.address)
        self._now_ns = 0
        self._next_dm1_ns: int | None = None
        self._told: dict[str, tuple[bool, int]] = {}  # fault -> active when told, and when
        self._changed: set[str] = set()
        self._answers: dict[int, Callable[[], bytes]] = {
            dm.DM1: lambda: self._message(self._active()),
            dm.DM2: lambda: self._message(self._previous()),
            dm.DM5: self._readiness,
            dm.DM6: lambda: self._message(self._pending()),
            dm.DM12: lambda: self._message([c for c in self._active() if c[0].emission_related]),
            dm.DM24: lambda: dm.spn_support(params.freeze_frame),
            dm.DM25: self._freeze_frames,
            dm.DM28: lambda: self._message(self._permanent()),
        }

    def succeed(self, old: Output, buses: Mapping[int, int]) -> None:
        """Keep the address, the sessions of the transport protocol, and what was told already."""
        if not isinstance(old, J1939Output) or buses.get(old._bus) != self._bus:
            return
        if (old._params.name, old._params.address) == (self._params.name, self._params.address):
            self._claim, self.transport, self._now_ns = old._claim, old.transport, old._now_ns
            self._next_dm1_ns, self._told = old._next_dm1_ns, old._told
            self._changed = old._changed

    def identifiers(self, bus: int) -> list[int] | None:
        """Anything on its bus may be for it."""
        return None if bus == self._bus else []

    def wanted(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames are of its protocols and for its address, or for all."""
        ids = frames["can_id"]
        group = (ids >> 16) & 0x3FF
        destination = (ids >> 8) & 0xFF
        mine = (destination == GLOBAL) | (destination == self._claim.address)
        pages = {pgn >> 8 for pgn in (REQUEST, TP_CM, TP_DT, ADDRESS_CLAIMED)}
        known = np.isin(group, sorted(pages))
        kind = (ids & (EXTENDED | ERROR | REMOTE)) == EXTENDED
        return np.asarray(kind & known & mine & (frames["bus"] == self._bus), np.bool_)

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Take a claim, a request, or a part of a longer message."""
        self._now_ns = max(self._now_ns, t_ns)
        pdu = read_pdu(frame)
        if pdu.pgn == ADDRESS_CLAIMED:
            made = self._claim.on_claim(pdu, self._now_ns)
            if self.transport.address != self._claim.address:
                self.transport.reset()
                self.transport.address = self._claim.address
            return self._frames(made)
        if not self._claim.claimed:
            return empty(0)
        if pdu.pgn == REQUEST:
            return self._frames(self._on_request(pdu))
        made, message = self.transport.on_pdu(pdu, self._now_ns)
        if message is not None and message.pgn == REQUEST:
            made += self._on_request(
                Pdu(REQUEST, message.source, message.destination, message.data)
            )
        return self._frames(made)

    def _on_request(self, pdu: Pdu) -> list[Pdu]:
        if len(pdu.data) < 3:
            return []
        pgn = int.from_bytes(pdu.data[:3], "little")
        # What is asked of all is answered to all (J1939-21, 5.4.2).
        to = GLOBAL if pdu.destination == GLOBAL else pdu.source
        if pgn == ADDRESS_CLAIMED:
            return self._claim.on_request()
        if pgn in (dm.DM3, dm.DM11):
            return self._clear(pgn, pdu)
        answer = self._answers.get(pgn)
        if answer is None:
            return self._acknowledge(_NEGATIVE, pgn, pdu)
        return self.transport.send(pgn, answer(), to, self._now_ns)

    def _acknowledge(self, kind: int, pgn: int, pdu: Pdu) -> list[Pdu]:
        """Acknowledge what was asked of us alone; nobody is told of a request to all."""
        if pdu.destination == GLOBAL:
            return []
        data = bytes([kind, 0xFF, 0xFF, 0xFF, pdu.source]) + pgn_bytes(pgn)
        return [Pdu(ACKNOWLEDGMENT, self.transport.address, GLOBAL, data)]

    def _clear(self, pgn: int, pdu: Pdu) -> list[Pdu]:
        if not self._params.allow_clear:
            return self._acknowledge(_DENIED, pgn, pdu)
        try:
            if pgn == dm.DM11:
                self._control.clear(ALL_DTCS)
            else:
                for _, entry in self._previous():
                    self._control.clear(entry.dtc.value)
        except StoreError:  # what was not cleared durably is there still
            return self._acknowledge(_NEGATIVE, pgn, pdu)
        return self._acknowledge(_POSITIVE, pgn, pdu)

    def _coded(self, entries: list[Entry]) -> list[dm.Coded]:
        """Return entries of faults with SPN and FMI, with their definitions."""
        found = [(self._memory.definition(entry.fault), entry) for entry in entries]
        return [coded for coded in found if coded[0].spn is not None]

    def _in_order(self) -> list[dm.Coded]:
        return self._coded(self._memory.in_order("first_failed"))

    def _active(self) -> list[dm.Coded]:
        both = Status.CONFIRMED_DTC | Status.TEST_FAILED
        return [coded for coded in self._in_order() if coded[1].status & both == both]

    def _previous(self) -> list[dm.Coded]:
        both = Status.CONFIRMED_DTC | Status.TEST_FAILED
        return [
            coded for coded in self._in_order() if coded[1].status & both == Status.CONFIRMED_DTC
        ]

    def _pending(self) -> list[dm.Coded]:
        return [coded for coded in self._in_order() if coded[1].status & Status.PENDING_DTC]

    def _permanent(self) -> list[dm.Coded]:
        return self._coded([self._memory.entry(p.fault) for p in self._memory.permanent()])

    def _message(self, dtcs: list[dm.Coded]) -> bytes:
        lit = {
            definition.lamp
            for definition, entry in self._in_order()
            if entry.status & Status.WARNING_INDICATOR
        }
        return dm.dtc_message(dm.lamp_bytes(lit, self._params.lamps), dtcs)

    def _readiness(self) -> bytes:
        return dm.readiness_message(
            len(self._active()),
            len(self._previous()),
            self._params.obd_compliance,
            readiness(self._memory),
        )

    def _freeze_frames(self) -> bytes:
        frames = [
            (coded, frame.content) for coded in self._in_order() for frame in coded[1].freeze_frames
        ]
        return dm.freeze_frames(frames, self._params.freeze_frame)

    def on_changes(self, changes: Sequence[DtcChange], t_ns: int) -> Frames:
        """Note DTCs that changed; :meth:`on_time` sends them."""
        self._changed |= {c.definition.id for c in changes if c.definition.spn is not None}
        return empty(0)

    def on_time(self, t_ns: int) -> Frames:
        """Claim, send what is due of longer messages, and DM1."""
        self._now_ns = max(self._now_ns, t_ns)
        made = self._claim.on_time(self._now_ns)
        if self._claim.claimed:
            made += self.transport.on_time(self._now_ns)
            if self._dm1_is_due():
                made += self._send_dm1()
        return self._frames(made)

    def _dm1_is_due(self) -> bool:
        if self._next_dm1_ns is None or self._now_ns >= self._next_dm1_ns:
            return True
        return any(self._is_news(fault) for fault in self._changed)

    def _is_news(self, fault: str) -> bool:
        """Tell whether a DTC became active or inactive, and was not told of in the last second."""
        told, when = self._told.get(fault, _NEVER_TOLD)
        return self._is_active(fault) != told and self._now_ns - when >= _CHANGE_NS

    def _is_active(self, fault: str) -> bool:
        both = Status.CONFIRMED_DTC | Status.TEST_FAILED
        return self._memory.status(fault) & both == both

    def _send_dm1(self) -> list[Pdu]:
        cycle = round(self._params.cycle_ms * 1e6)
        cyclic = self._next_dm1_ns is None or self._now_ns >= self._next_dm1_ns
        if cyclic:
            late = self._next_dm1_ns is None or self._now_ns - self._next_dm1_ns > cycle
            self._next_dm1_ns = (self._now_ns if late else self._next_dm1_ns or 0) + cycle
        active = self._active()
        if cyclic and not active and not self._params.when_clear and not self._changed:
            return []
        for fault in list(self._changed):
            if not cyclic and not self._is_news(fault):
                continue
            self._told[fault] = self._is_active(fault), self._now_ns
            self._changed.discard(fault)
        return self.transport.send(dm.DM1, self._message(active), GLOBAL, self._now_ns)

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`on_time` has something to do."""
        if not self._claim.claimed:
            return self._claim.next_ns
        waiting = [self.transport.next_ns, self._next_dm1_ns or 0]
        for fault in self._changed:
            told, when = self._told.get(fault, _NEVER_TOLD)
            if self._is_active(fault) != told:
                waiting.append(when + _CHANGE_NS)
        return min(waiting)

    def counters(self) -> dict[str, int]:
        """Return transport sessions that came to nothing, and those there was no room for."""
        return {"j1939_aborted": self.transport.aborted, "j1939_refused": self.transport.refused}

    def _frames(self, made: list[Pdu]) -> Frames:
        return to_frames(made, self._bus, self._now_ns)
