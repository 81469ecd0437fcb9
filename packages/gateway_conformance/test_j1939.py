"""J1939 (SAE J1939-21, -73, -81): address, requests and their refusals, DM1, messages of several packets."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import pytest

from gateway.bus.frames import EXTENDED, empty, put
from gateway.j1939.frame import (
    ACKNOWLEDGMENT,
    ADDRESS_CLAIMED,
    GLOBAL,
    REQUEST,
    TP_CM,
    TP_DT,
    Pdu,
    pgn_bytes,
    read_pdu,
)
from gateway.j1939.transport import ABORT, BAM, BAM_GAP_NS, CTS, END_OF_MESSAGE, LONGEST, RTS, Message, Transport
from gateway_ask.clients.pgn import TOOL
from gateway_conformance.target import MS, CanTarget, fails, shown
from gateway_conformance.wires import Heard

DM1, DM2 = 0xFECA, 0xFECB
#: Groups whose answers may have several packets: component, software and vehicle identification, DM1, DM2, DM24, DM5.
LONG = (0xFEEB, 0xFEDA, 0xFEEC, DM1, DM2, 0xFDB6, 0xFDB7)
#: A group that nobody has: of data page 1, reserved.
NO_PGN = 0x1F0F0
#: Tr, the longest wait for an answer (J1939-21); least and greatest gap of a broadcast's packets.
TR_NS, LEAST_NS, GREATEST_NS = 1250 * MS, BAM_GAP_NS, 200 * MS


def _pdu(one: Heard) -> Pdu | None:
    if not one.can_id & EXTENDED:
        return None
    made = empty(1)
    put(made, 0, one.t_ns, one.can_id, one.data)
    return read_pdu(made[0])


def _heard(target: CanTarget, ns: int) -> Iterator[tuple[int, Pdu]]:
    """Yield the target's frames of this time, each with its stamp."""
    until = target.wire.now_ns() + ns
    while (rest := until - target.wire.now_ns()) > 0:
        for one in target.wire.wait(rest):
            pdu = _pdu(one)
            if pdu is not None and pdu.source == target.address:
                yield one.t_ns, pdu


def _request(target: CanTarget, pgn: int, to_all: bool = False) -> None:
    target.wire.wait(0)
    assert target.address is not None
    target.wire.send(Pdu(REQUEST, TOOL, GLOBAL if to_all else target.address, pgn_bytes(pgn)).can_id, pgn_bytes(pgn))


def _message(target: CanTarget, pgn: int, ns: int = TR_NS, source: int = TOOL) -> Message | None:
    """Return a message of the target, put together; refusals are messages, too."""
    transport = Transport(source)
    for _, pdu in _heard(target, ns + target.slack_ns):
        if pdu.pgn in (TP_CM, TP_DT):
            out, message = transport.on_pdu(pdu, target.wire.now_ns())
            for made in out:
                target.wire.send(made.can_id, made.data)
            if message is not None and message.pgn == pgn:
                return message
        elif pdu.pgn == pgn or (pdu.pgn == ACKNOWLEDGMENT and pdu.data[5:8] == pgn_bytes(pgn)):
            return Message(pdu.pgn, pdu.source, pdu.destination, pdu.data)
    return None


def _wanted(target: CanTarget, pgn: int) -> Message:
    """Return the answer to a request of a group; skips the case where it is refused."""
    _request(target, pgn)
    message = _message(target, pgn, 5 * TR_NS)
    if message is None:
        fails(f"requested PGN {pgn:04X} of {target.address:02X}", "an answer or an acknowledgment", "nothing")
    if message.pgn == ACKNOWLEDGMENT:
        pytest.skip(f"PGN {pgn:04X} is refused with {message.data[0]}")
    return message


@pytest.mark.parametrize("to_all", [False, True])
def test_address_claim(target: CanTarget, to_all: bool) -> None:
    """SAE J1939-81: a request for PGN 60928, to all or to one, is answered to all with a NAME of 8 bytes."""
    _request(target, ADDRESS_CLAIMED, to_all)
    message = _message(target, ADDRESS_CLAIMED)
    if message is None or message.destination != GLOBAL or len(message.data) != 8:
        fails("requested PGN EE00", "a claim to all, 8 bytes", "nothing" if message is None else shown(message.data))
    if int.from_bytes(message.data, "little") >> 48 & 1:
        fails("requested PGN EE00", "a NAME whose reserved bit is 0", shown(message.data))


def _lamps_and_dtcs(asked: str, data: bytes) -> None:
    """Expect two bytes of lamps and DTCs of four bytes, or the form for none (J1939-73, 5.7.1)."""
    body = data[2:6] if len(data) == 8 and data[6:] == b"\xff\xff" else data[2:]
    if len(data) < 6 or len(body) % 4:
        fails(asked, "two bytes of lamps, and four bytes of each DTC", shown(data))


def test_dm1_comes_by_itself(target: CanTarget) -> None:
    """SAE J1939-73, 5.7.1: DM1 comes once a second where a DTC is active; where none comes, it is there on request."""
    message = _message(target, DM1, 2500 * MS, 0xFE)
    if message is None or message.pgn == ACKNOWLEDGMENT:
        message = _wanted(target, DM1)
    _lamps_and_dtcs("listened for DM1", message.data)


@pytest.mark.parametrize("pgn", [DM1, DM2])
def test_requested_dtcs(target: CanTarget, pgn: int) -> None:
    """SAE J1939-73, 5.7.1, 5.7.2: DM1 and DM2 on request have lamps, and DTCs of four bytes."""
    _lamps_and_dtcs(f"requested PGN {pgn:04X}", _wanted(target, pgn).data)


def test_an_unknown_group(target: CanTarget) -> None:
    """SAE J1939-21, 5.4.4: a request to one for a group that is not there is refused: control byte 1, whom, which."""
    _request(target, NO_PGN)
    message = _message(target, NO_PGN)
    asked = f"requested PGN {NO_PGN:05X} of {target.address:02X}"
    if message is None or message.pgn != ACKNOWLEDGMENT:
        fails(asked, "a negative acknowledgment (PGN E800)", "nothing" if message is None else shown(message.data))
    if message.data[0] not in (1, 2, 3) or message.data[4] not in (TOOL, 0xFF):
        fails(asked, f"control byte 1 to 3, {TOOL:02X} as the fifth byte", shown(message.data))


def test_an_unknown_group_of_all(target: CanTarget) -> None:
    """SAE J1939-21, 5.4.4: a request to all for a group that is not there is not refused."""
    _request(target, NO_PGN, to_all=True)
    message = _message(target, NO_PGN)
    if message is not None:
        fails(f"requested PGN {NO_PGN:05X} of all", "nothing", shown(message.data))


def _control(target: CanTarget, pgn: int, *rest: int) -> None:
    assert target.address is not None
    data = bytes(rest) + pgn_bytes(pgn)
    target.wire.send(Pdu(TP_CM, TOOL, target.address, data, 7).can_id, data)


def _transport(target: CanTarget, ns: int) -> list[tuple[int, Pdu]]:
    """Return the target's packets to the tool of this time."""
    return [(t, pdu) for t, pdu in _heard(target, ns) if pdu.pgn in (TP_CM, TP_DT) and pdu.destination == TOOL]


@pytest.fixture(scope="module")
def long(target: CanTarget) -> int:
    """Return a group whose answer has several packets."""
    for pgn in LONG:
        _request(target, pgn)
        message = _message(target, pgn, 5 * TR_NS)
        if message is not None and len(message.data) > 14:
            return pgn
    pytest.skip("no group has an answer of three packets")


def _announced(target: CanTarget, pgn: int) -> tuple[int, int]:
    """Request a long group, and expect its RTS; returns size and packets."""
    _request(target, pgn)
    header = next((pdu.data for _, pdu in _transport(target, 300 * MS + target.slack_ns) if pdu.pgn == TP_CM), b"")
    size, packets = int.from_bytes(header[1:3], "little"), (header + bytes(4))[3]
    if (
        header[:1] != bytes([RTS])
        or not 9 <= size <= LONGEST
        or packets != -(-size // 7)
        or header[5:] != pgn_bytes(pgn)
    ):
        fails(f"requested PGN {pgn:04X}", "RTS: 10h, size, packets, PGN", shown(header) or "nothing")
    return size, packets


def test_clear_to_send(target: CanTarget, long: int) -> None:
    """SAE J1939-21, 5.10: packets come after CTS only, as many as it grants; CTS of 0 holds the connection."""
    _, packets = _announced(target, long)
    _control(target, long, CTS, 1, 1, 0xFF, 0xFF)
    one = [pdu.data[0] for _, pdu in _transport(target, 200 * MS)]
    _control(target, long, CTS, 0, 0xFF, 0xFF, 0xFF)
    held = _transport(target, 400 * MS)
    _control(target, long, CTS, packets - 1, 2, 0xFF, 0xFF)
    rest = [pdu.data[0] for _, pdu in _transport(target, 500 * MS)]
    _control(target, long, END_OF_MESSAGE, 0, 0, packets, 0xFF)
    asked = f"requested PGN {long:04X}, {packets} packets"
    if one != [1] or held:
        fails(f"{asked}; CTS for one, then hold", "packet 1 and no other", f"{one}, then {len(held)}")
    if rest != [*range(2, packets + 1)]:
        fails(f"{asked}; CTS for the rest", f"packets 2 to {packets}", str(rest))


def test_abort(target: CanTarget, long: int) -> None:
    """SAE J1939-21, 5.10: after an abort no packet comes."""
    _, packets = _announced(target, long)
    _control(target, long, ABORT, 1, 0xFF, 0xFF, 0xFF)
    _control(target, long, CTS, packets, 1, 0xFF, 0xFF)
    came = [pdu for _, pdu in _transport(target, 300 * MS) if pdu.pgn == TP_DT]
    if came:
        fails(f"requested PGN {long:04X}, then aborted", "no packet", shown(came[0].data))


def test_a_receiver_that_falls_silent(target: CanTarget, long: int) -> None:
    """SAE J1939-21, 5.10: without CTS the connection is aborted after T3 (1.25 s)."""
    _announced(target, long)
    came = _transport(target, 1400 * MS + target.slack_ns)
    if [pdu.data[0] for _, pdu in came] != [ABORT]:
        fails(
            f"requested PGN {long:04X}, no CTS sent",
            "an abort (255)",
            ", ".join(shown(p.data) for _, p in came) or "nothing",
        )


def test_broadcast(target: CanTarget, long: int) -> None:
    """SAE J1939-21, 5.10: BAM, then all packets by their numbers, 50 to 200 ms apart."""
    _request(target, long, to_all=True)
    found: list[tuple[int, Pdu]] = []
    for stamp, pdu in _heard(target, 5000 * MS):
        if pdu.pgn in (TP_CM, TP_DT) and pdu.destination == GLOBAL:
            ours = pdu.pgn == TP_CM and pdu.data[0] == BAM and pdu.data[5:] == pgn_bytes(long)
            if found or ours:
                found.append((stamp, pdu))
        if found and len(found) > found[0][1].data[3]:
            break
    asked = f"requested PGN {long:04X} of all"
    if not found:
        pytest.skip("a request to all is not answered by BAM")
    numbers = [pdu.data[0] for _, pdu in found[1:]]
    if numbers != [*range(1, found[0][1].data[3] + 1)]:
        fails(asked, f"packets 1 to {found[0][1].data[3]}", str(numbers))
    gaps = [(b - a) for (a, _), (b, _) in pairwise(found)]
    if min(gaps) < LEAST_NS - target.slack_ns or max(gaps) > GREATEST_NS + target.slack_ns:
        fails(asked, "packets 50 to 200 ms apart", f"{min(gaps) // MS} to {max(gaps) // MS} ms")


def test_a_long_request_to_it(target: CanTarget) -> None:
    """SAE J1939-21, 5.10: RTS is granted by CTS from packet 1, refused by an abort where it cannot be; not ignored."""
    _control(target, 0xEF00, RTS, 20, 0, 3, 0xFF)
    came = [pdu.data for _, pdu in _transport(target, 300 * MS + target.slack_ns)]
    if not came or came[0][0] not in (CTS, ABORT) or (came[0][0] == CTS and came[0][2] != 1):
        fails("sent RTS of 20 bytes", "CTS from packet 1, or an abort", ", ".join(map(shown, came)) or "nothing")
    _control(target, 0xEF00, ABORT, 1, 0xFF, 0xFF, 0xFF)
