"""0x2E WriteDataByIdentifier (ISO 14229-1, 10.7): identifiers set to be writable; kept in the fault memory's file."""

from __future__ import annotations

from gateway.faults.store import StoreError
from gateway.servers.uds.context import Context, Service
from gateway.servers.uds.nrc import NegativeError, Nrc, refuse_unless


def _handle(c: Context, request: bytes) -> bytes:
    number = int.from_bytes(request[1:3], "big")
    did = c.identifiers.table.get(number)
    refuse_unless(did is not None and did.writable, Nrc.REQUEST_OUT_OF_RANGE)
    assert did is not None
    c.check_security()
    refuse_unless(len(request) - 3 == len(did.constant), Nrc.INCORRECT_LENGTH)
    c.check_conditions()
    try:
        c.identifiers.write(number, request[3:])
    except StoreError as error:
        raise NegativeError(Nrc.GENERAL_PROGRAMMING_FAILURE) from error
    return request[1:3]


SERVICE = Service(
    0x2E,
    "WriteDataByIdentifier",
    _handle,
    shortest=4,
    action="write",
    traced=lambda _: True,
    late=True,
    offered=lambda c: any(did.writable for did in c.identifiers.table.values()),
)
