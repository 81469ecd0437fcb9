"""0x29 Authentication (ISO 14229-1, 10.6): by certificate and proof of its key, one way (APCE)."""

from __future__ import annotations

from gateway.servers.uds.context import NOT_DEFAULT, Context, Service
from gateway.servers.uds.nrc import Nrc, refuse_unless

END, VERIFY, PROVE, CONFIGURATION = 0x00, 0x01, 0x03, 0x08
#: Return parameters: by certificate (APCE); ended; ownership is to be proven; complete.
APCE, ENDED, PROVE_NEXT, COMPLETE = 0x02, 0x10, 0x11, 0x12


def _parts(data: bytes, count: int) -> list[bytes]:
    """Return a number of fields, each with its length in two bytes before it, that fill the data."""
    found = []
    for _ in range(count):
        refuse_unless(len(data) >= 2, Nrc.INCORRECT_LENGTH)
        length = int.from_bytes(data[:2], "big")
        refuse_unless(len(data) >= 2 + length, Nrc.INCORRECT_LENGTH)
        found.append(data[2 : 2 + length])
        data = data[2 + length :]
    refuse_unless(not data, Nrc.INCORRECT_LENGTH)
    return found


def _field(data: bytes) -> bytes:
    return len(data).to_bytes(2, "big") + data


def _handle(c: Context, request: bytes) -> bytes:
    number = request[1] & 0x7F
    if number in (END, CONFIGURATION):
        refuse_unless(len(request) == 2, Nrc.INCORRECT_LENGTH)
        if number == CONFIGURATION:
            return bytes([number, APCE])
        c.authentication.end()
        return bytes([number, ENDED])
    if number == VERIFY:
        refuse_unless(len(request) > 3, Nrc.INCORRECT_LENGTH)
        certificate, challenge = _parts(request[3:], 2)
        refuse_unless(request[2] == 0, Nrc.REQUEST_OUT_OF_RANGE)  # the next messages are not encrypted
        c.check_conditions()
        ours = c.authentication.challenge(certificate, challenge, c.control.wall_ns(), c.now_ns)
        return bytes([number, PROVE_NEXT]) + _field(ours) + _field(b"")
    proof, _ephemeral = _parts(request[2:], 2)
    c.check_conditions()
    c.authentication.prove(proof, c.now_ns)
    return bytes([number, COMPLETE]) + _field(b"")


SERVICE = Service(
    0x29,
    "Authentication",
    _handle,
    lambda _: dict.fromkeys((END, VERIFY, PROVE, CONFIGURATION), NOT_DEFAULT),
    shortest=2,
    sessions=NOT_DEFAULT,
    action="authenticate",
    undoes=lambda request: request[1:2] in (b"\x00", b"\x80"),
    traced=lambda request: request[1:2] in (b"\x01", b"\x81", b"\x03", b"\x83"),
    offered=lambda c: c.authentication.offered,
)
