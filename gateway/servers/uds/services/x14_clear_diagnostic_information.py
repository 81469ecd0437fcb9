"""0x14 ClearDiagnosticInformation (ISO 14229-1, 11.2): all DTCs, a group, or one."""

from __future__ import annotations

from gateway.faults.store import StoreError
from gateway.servers.uds.context import Context, Service
from gateway.servers.uds.nrc import NegativeError, Nrc, refuse_unless


def _handle(c: Context, request: bytes) -> bytes:
    group = int.from_bytes(request[1:4], "big")
    refuse_unless(c.control.knows(group), Nrc.REQUEST_OUT_OF_RANGE)
    c.check_conditions()
    try:
        c.control.clear(group)
    except StoreError as error:  # nothing was cleared, or it would come back at the next start
        raise NegativeError(Nrc.GENERAL_PROGRAMMING_FAILURE) from error
    return b""


SERVICE = Service(
    0x14,
    "ClearDiagnosticInformation",
    _handle,
    shortest=4,
    longest=4,
    action="clear",
    traced=lambda _: True,
)
