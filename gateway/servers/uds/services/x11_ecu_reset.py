"""0x11 ECUReset (ISO 14229-1, 9.3): the operation cycle ends and the next one begins.

The process goes on: a reset means a new operation cycle for the fault memory, and the default session for the server.
Hard reset, key off and on, and soft reset are the same here.
"""

from __future__ import annotations

from gateway.servers.authority import LASTING
from gateway.servers.uds.context import ANY_SESSION, DEFAULT, Context, Service

HARD, KEY_OFF_ON, SOFT = 0x01, 0x02, 0x03


def _handle(c: Context, request: bytes) -> bytes:
    c.check_conditions()
    for tester in c.testers:  # a reset is one for all
        tester.enter(DEFAULT)
    c.authority.end_yielding(LASTING)
    c.control.restart_cycle()
    return bytes([request[1] & 0x7F])


SERVICE = Service(
    0x11,
    "ECUReset",
    _handle,
    lambda _: dict.fromkeys((HARD, KEY_OFF_ON, SOFT), ANY_SESSION),
    shortest=2,
    longest=2,
    action="reset",
    traced=lambda _: True,
)
