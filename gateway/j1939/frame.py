"""Identifiers and parameter groups (SAE J1939-21)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gateway.bus.frames import EXTENDED, Frames, empty, payload, put

GLOBAL, NULL = 0xFF, 0xFE

ACKNOWLEDGMENT = 0xE800
REQUEST = 0xEA00
TP_DT = 0xEB00
TP_CM = 0xEC00
ADDRESS_CLAIMED = 0xEE00
COMMANDED_ADDRESS = 0xFED8


@dataclass(frozen=True)
class Pdu:
    """One frame: parameter group, sender, receiver, up to 8 bytes."""

    pgn: int
    source: int
    destination: int
    data: bytes
    priority: int = 6

    @property
    def can_id(self) -> int:
        """Identifier, with EXTENDED."""
        number = self.priority << 26 | self.pgn << 8 | self.source
        if (self.pgn >> 8) & 0xFF < 240:  # PDU1: to an address
            number |= self.destination << 8
        return number | EXTENDED


def group_of(can_id: Any) -> Any:
    """Return the parameter group number of an identifier of 29 bits, or of an array of them, without destination."""
    return can_id >> 8 & (0x3FFFF - 0xFF * ((can_id >> 16 & 0xFF) < 240))


def read_pdu(frame: np.void) -> Pdu:
    """Return an extended frame as a PDU."""
    return pdu_of(int(frame["can_id"]), payload(frame))


def pdu_of(can_id: int, data: bytes) -> Pdu:
    """Return a frame of an identifier of 29 bits as a PDU."""
    to_one = can_id >> 16 & 0xFF < 240
    return Pdu(group_of(can_id), can_id & 0xFF, can_id >> 8 & 0xFF if to_one else GLOBAL, data, can_id >> 26 & 7)


def to_frames(pdus: list[Pdu], bus: int, t_ns: int) -> Frames:
    """Return PDUs as frames of a bus."""
    frames = empty(len(pdus))
    for k, pdu in enumerate(pdus):
        put(frames, k, t_ns, pdu.can_id, pdu.data, bus=bus)
    return frames


def pgn_bytes(pgn: int) -> bytes:
    """Return a parameter group number as the transport protocol has it: low byte first."""
    return pgn.to_bytes(3, "little")
