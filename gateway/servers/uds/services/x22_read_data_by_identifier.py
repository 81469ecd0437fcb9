"""0x22 ReadDataByIdentifier (ISO 14229-1, 10.2): identifiers of the configuration, signals as they are now."""

from __future__ import annotations

from gateway.servers.identifiers import ACTIVE_SESSION
from gateway.servers.uds.context import Context, Service
from gateway.servers.uds.nrc import Nrc, refuse_unless


def _handle(c: Context, request: bytes) -> bytes:
    refuse_unless(len(request) % 2 == 1, Nrc.INCORRECT_LENGTH)
    made = b""
    for at in range(1, len(request), 2):
        number = int.from_bytes(request[at : at + 2], "big")
        data = bytes([c.session]) if number == ACTIVE_SESSION else c.identifiers.read(number)
        if data is not None:  # of several, those that are there are answered
            made += request[at : at + 2] + data
    refuse_unless(bool(made), Nrc.REQUEST_OUT_OF_RANGE)
    c.check_security()
    c.check_conditions()
    return made


SERVICE = Service(0x22, "ReadDataByIdentifier", _handle, shortest=3, action="read_data", late=True)
