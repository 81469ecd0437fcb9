"""DoIP (ISO 13400-2:2019): identification, headers, activation and its denials, alive check, diagnostic messages."""

from __future__ import annotations

import struct

import pytest

from gateway_conformance.doip import DoipTarget, Message, Stream
from gateway_conformance.target import fails, shown
from gateway_testers.doip.codec import ANY_VERSION, HEADER, VERSIONS, Activation, HeaderNack, Kind, Nack, packed

#: Payload type, activation type, source and target that the standard reserves.
NO_KIND, NO_ACTIVATION, NO_SOURCE, NO_TARGET = 0x0FFF, 0x40, 0x0000, 0x0001
OTHER_VERSION = 0x0F


def _expect(asked: str, told: Message | None, kind: int, start: bytes = b"") -> bytes:
    """Expect a message of a kind that begins so; returns its payload."""
    if told is None or told.kind != kind or not told.body.startswith(start):
        came = "nothing" if told is None else f"type {told.kind:04X}: {shown(told.body)}"
        fails(asked, f"payload type {kind:04X} {shown(start)}", came)
    return told.body


def _ask(target: DoipTarget, kind: int, body: bytes = b"", version: int = VERSIONS[-1]) -> Message | None:
    return target.datagram(packed(kind, body, version))


def _vehicle(target: DoipTarget) -> bytes:
    body = _expect("asked by UDP for identification", _ask(target, Kind.IDENTIFY), Kind.VEHICLE)
    if len(body) not in (32, 33):
        fails("asked by UDP for identification", "32 or 33 bytes", f"{len(body)}")
    return body


@pytest.mark.parametrize("version", [*VERSIONS, ANY_VERSION])
def test_identification(target: DoipTarget, version: int) -> None:
    """ISO 13400-2, 7.4: VIN, logical address, EID, GID, further action; asked in versions 2, 3 and FF."""
    body = _expect(f"asked in version {version:02X}", _ask(target, Kind.IDENTIFY, b"", version), Kind.VEHICLE)
    if len(body) not in (32, 33) or (not any(body[:17]) and any(b < 0x20 for b in body[:17] if b)):
        fails("asked by UDP for identification", "a VIN of 17 characters or unset, 32 or 33 bytes", shown(body))


def test_identification_by_eid_and_vin(target: DoipTarget) -> None:
    """ISO 13400-2, 7.4: who is asked for by its own EID or VIN answers, and no other does."""
    body = _vehicle(target)
    vin, eid = body[:17], body[19:25]
    for kind, own in ((Kind.IDENTIFY_BY_EID, eid), (Kind.IDENTIFY_BY_VIN, vin)):
        _expect(f"asked for {shown(own)}", _ask(target, kind, own), Kind.VEHICLE, body[:25])
        other = bytes([own[0] ^ 0x55]) + own[1:]
        told = target.datagram(packed(kind, other, VERSIONS[-1]), 0.3)
        if told is not None:
            fails(f"asked for {shown(other)}, which it is not", "no answer", f"type {told.kind:04X}")


def test_entity_status(target: DoipTarget) -> None:
    """ISO 13400-2, 7.4: node type 0 or 1, places, places that are taken, and the longest message."""
    body = _expect("asked for the entity's status", _ask(target, Kind.STATUS_REQUEST), Kind.STATUS)
    if len(body) not in (3, 7) or body[0] > 1 or body[2] > body[1]:
        fails("asked for the entity's status", "type 0 or 1, places, fewer taken, 3 or 7 bytes", shown(body))


def test_power_mode(target: DoipTarget) -> None:
    """ISO 13400-2, 7.4: not ready (0), ready (1), not supported (2)."""
    body = _expect("asked for the power mode", _ask(target, Kind.POWER_REQUEST), Kind.POWER)
    if len(body) != 1 or body[0] > 2:
        fails("asked for the power mode", "0, 1 or 2", shown(body))


#: Headers that are wrong -> code of the refusal.
HEADERS = {
    "inverse version": (HEADER.pack(3, 3, Kind.IDENTIFY, 0), HeaderNack.INCORRECT_PATTERN),
    "version": (packed(Kind.IDENTIFY, b"", OTHER_VERSION), HeaderNack.INCORRECT_PATTERN),
    "payload type": (packed(NO_KIND, b"", 3), HeaderNack.UNKNOWN_TYPE),
    "length": (packed(Kind.IDENTIFY, b"\0", 3), HeaderNack.INVALID_LENGTH),
}


@pytest.mark.parametrize("wrong", HEADERS)
def test_datagrams_refused(target: DoipTarget, wrong: str) -> None:
    """ISO 13400-2, 7.1.5: a header that is wrong is refused with its code."""
    data, code = HEADERS[wrong]
    _expect(f"sent a datagram of a wrong {wrong}", target.datagram(data), Kind.NACK, bytes([code]))


@pytest.mark.parametrize(
    ("wrong", "data", "code", "ends"),
    [
        ("inverse version", HEADER.pack(3, 3, Kind.ACTIVATE, 0), HeaderNack.INCORRECT_PATTERN, True),
        ("payload type", packed(NO_KIND, b"", 3), HeaderNack.UNKNOWN_TYPE, False),
        ("size (4 GiB)", HEADER.pack(3, 0xFC, Kind.DIAGNOSTIC, 0xFFFFFFFF), HeaderNack.TOO_LARGE, False),
        ("length", packed(Kind.ACTIVATE, b"\0\0", 3), HeaderNack.INVALID_LENGTH, True),
    ],
)
def test_streams_refused(target: DoipTarget, wrong: str, data: bytes, code: int, ends: bool) -> None:
    """ISO 13400-2, 7.1.5, Figure 14: a header that is wrong is refused; after codes 00 and 04 the connection ends."""
    one = target.activated()
    one.send_raw(data)
    _expect(f"sent a wrong {wrong} by TCP", one.next(), Kind.NACK, bytes([code]))
    if ends and not one.ends():
        fails(f"sent a wrong {wrong} by TCP", "the end of the connection", "it is open still")
    if wrong == "payload type":
        _serves(target, one)
    one.close()


def _serves(target: DoipTarget, one: Stream) -> None:
    one.send(Kind.DIAGNOSTIC, target.diagnostic(b"\x3e\x00"))
    _expect("asked 3E 00", one.next(), Kind.DIAGNOSTIC_ACK)
    _expect("asked 3E 00", one.next(), Kind.DIAGNOSTIC, struct.pack(">HH", target.address, target.source) + b"\x7e\x00")


def test_activation(target: DoipTarget) -> None:
    """ISO 13400-2, clause 8: the answer has the tester's address, the entity's, and 10; again, it is 10 again."""
    one = target.activated()
    body = _expect("asked for routing again", one.activate(target.source), Kind.ACTIVATED)
    if len(body) not in (9, 13) or body[:2] != target.source.to_bytes(2, "big") or body[4] != Activation.DONE:
        fails("asked for routing", f"{target.source:04X}, the entity's address, 10, four bytes", shown(body))
    one.close()


@pytest.mark.parametrize(
    ("source", "kind", "code"),
    [(NO_SOURCE, 0, Activation.UNKNOWN_SOURCE), (None, NO_ACTIVATION, Activation.UNSUPPORTED_TYPE)],
)
def test_activation_denied(target: DoipTarget, source: int | None, kind: int, code: int) -> None:
    """ISO 13400-2, clause 8: an unknown source is denied with 00, an unknown type with 06; the connection ends."""
    target.close()
    one = target.stream()
    number = target.source if source is None else source
    asked = f"asked for routing for {number:04X}, type {kind:02X}"
    body = _expect(asked, one.activate(number, kind), Kind.ACTIVATED, number.to_bytes(2, "big"))
    if body[4] != code:
        fails(asked, f"code {code:02X}", f"{body[4]:02X}")
    if not one.ends():
        fails(asked, "the end of the connection", "it is open still")
    one.close()


def test_another_source(target: DoipTarget) -> None:
    """ISO 13400-2, clause 8: another source address on an active connection is denied with 02."""
    one = target.activated()
    body = _expect("asked for another source", one.activate(target.source + 1), Kind.ACTIVATED)
    if body[4] not in (Activation.OTHER_SOURCE, Activation.UNKNOWN_SOURCE):
        fails("asked for another source on the same connection", "code 02 (00: it is unknown)", f"{body[4]:02X}")
    one.close()


def test_alive_check(target: DoipTarget) -> None:
    """ISO 13400-2, clause 8: a second connection of a source has the first one asked; if it lives: 03."""
    one, two = target.activated(), target.stream()
    two.send(Kind.ACTIVATE, struct.pack(">HBI", target.source, 0, 0))
    _expect("asked for routing elsewhere", one.next(), Kind.ALIVE_REQUEST)
    one.send(Kind.ALIVE, target.source.to_bytes(2, "big"))
    body = _expect("asked for routing elsewhere, the first lives", two.next(), Kind.ACTIVATED)
    if body[4] != Activation.ACTIVE_ELSEWHERE:
        fails("asked for routing elsewhere, the first lives", "code 03", f"{body[4]:02X}")
    _serves(target, one)
    one.close()
    two.close()


def test_a_dead_tester_gives_way(target: DoipTarget) -> None:
    """ISO 13400-2, clause 8: a connection that does not answer the alive check is closed; the other has its place."""
    one, two = target.activated(), target.stream()
    body = _expect("asked for routing elsewhere, the first is dumb", two.activate(target.source), Kind.ACTIVATED)
    if body[4] != Activation.DONE:
        fails("asked for routing elsewhere, the first is dumb", "code 10", f"{body[4]:02X}")
    if not one.ends():
        fails("did not answer the alive check", "the end of the connection", "it is open still")
    _serves(target, two)
    two.close()


def test_acknowledgement(target: DoipTarget) -> None:
    """ISO 13400-2, 9.5: a request is acknowledged (00) from its target to its source, then answered."""
    one = target.activated()
    one.send(Kind.DIAGNOSTIC, target.diagnostic(b"\x3e\x00"))
    addresses = struct.pack(">HH", target.address, target.source)
    _expect("asked 3E 00", one.next(), Kind.DIAGNOSTIC_ACK, addresses + b"\0")
    _expect("asked 3E 00", one.next(), Kind.DIAGNOSTIC, addresses + b"\x7e\x00")
    one.close()


def test_an_unknown_target(target: DoipTarget) -> None:
    """ISO 13400-2, 9.5: a target that is not there is refused with 03; the connection goes on."""
    one = target.activated()
    one.send(Kind.DIAGNOSTIC, target.diagnostic(b"\x3e\x00", target=NO_TARGET))
    addresses = struct.pack(">HH", NO_TARGET, target.source)
    _expect(f"asked {NO_TARGET:04X}", one.next(), Kind.DIAGNOSTIC_NACK, addresses + bytes([Nack.UNKNOWN_TARGET]))
    _serves(target, one)
    one.close()


@pytest.mark.parametrize("activated", [True, False])
def test_a_wrong_source(target: DoipTarget, activated: bool) -> None:
    """ISO 13400-2, 9.5: a source other than the activated one, or none activated, is refused with 02; it ends."""
    target.close()
    one = target.activated() if activated else target.stream()
    one.send(Kind.DIAGNOSTIC, target.diagnostic(b"\x3e\x00", source=target.source + activated))
    asked = "asked with a source that is not activated"
    told = one.next()
    if activated or told is not None:  # without an activation it may be closed at once
        body = _expect(asked, told, Kind.DIAGNOSTIC_NACK)
        if body[4] != Nack.INVALID_SOURCE:
            fails(asked, "code 02", f"{body[4]:02X}")
    if not one.ends():
        fails(asked, "the end of the connection", "it is open still")
    one.close()
