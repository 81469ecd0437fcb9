"""Parameter groups of J1939 on request (PGN 59904): the request, and frames that end it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from gateway.bus.frames import Frames
from gateway.config.ecu import MARK
from gateway.j1939.frame import ACKNOWLEDGMENT, GLOBAL, REQUEST, TP_CM, Pdu, pgn_bytes, read_pdu, to_frames
from gateway.j1939.transport import BAM, RTS

#: Source address of a service tool off board (SAE J1939, Appendix B).
TOOL = 0xF9
#: Longest wait for the answer, one of several packets included (SAE J1939-21, Tr) [ms].
WAIT_MS = 1250.0
#: Control byte of an acknowledgment -> negative response code that means the same: negative, access denied, busy.
_REFUSALS = {1: 0x31, 2: 0x33, 3: 0x22}


class Ended(NamedTuple):
    """A request that a frame ends: its bytes in the schedule; 0, or the code of the refusal."""

    request: bytes
    code: int


def request_of(pgn: int) -> bytes:
    """Return a request as a schedule has it."""
    return bytes([MARK]) + pgn_bytes(pgn)


def pgn_of(request: bytes) -> int:
    """Return the parameter group of a request of a schedule."""
    return int.from_bytes(request[1:], "little")


def frame_of(request: bytes, address: int, bus: int, t_ns: int) -> Frames:
    """Return the frame of a request to an address."""
    return to_frames([Pdu(REQUEST, TOOL, address, request[1:])], bus, t_ns)


def identifiers_of(requests: Iterable[bytes], address: int) -> set[int]:
    """Return the identifiers (with EXTENDED) of frames that may end requests to an address."""
    groups = [*map(pgn_of, requests)]
    return {
        Pdu(pgn, address, destination, b"", priority).can_id
        for pgn in ([*groups, TP_CM, ACKNOWLEDGMENT] if groups else [])
        for destination in (GLOBAL, TOOL)
        for priority in range(8)
    }


def ended_by(frame: np.void) -> Ended | None:
    """Return the request that a frame ends; None: none. An answer of several packets has come when it begins."""
    pdu = read_pdu(frame)
    if pdu.pgn not in (TP_CM, ACKNOWLEDGMENT):
        return Ended(request_of(pdu.pgn), 0)
    if len(pdu.data) < 8:
        return None
    request = bytes([MARK]) + pdu.data[5:8]
    if pdu.pgn == TP_CM:
        return Ended(request, 0) if pdu.data[0] in (RTS, BAM) else None
    return Ended(request, _REFUSALS[pdu.data[0]]) if pdu.data[0] in _REFUSALS else None
