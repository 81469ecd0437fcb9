"""0x27 SecurityAccess (ISO 14229-1, 9.4): seed by an odd sub-function, key by the even one after it."""

from __future__ import annotations

from gateway.servers.uds.context import NOT_DEFAULT, Context, Service, SubFunctions
from gateway.servers.uds.nrc import Nrc, refuse_unless


def _sub_functions(c: Context) -> SubFunctions:
    return {number: NOT_DEFAULT for level in c.security.levels for number in (2 * level - 1, 2 * level)}


def _handle(c: Context, request: bytes) -> bytes:
    number = request[1] & 0x7F
    level = (number + 1) // 2
    if number % 2:
        refuse_unless(len(request) == 2, Nrc.INCORRECT_LENGTH)
        c.check_conditions()
        return bytes([number]) + c.security.seed(level, c.now_ns)
    refuse_unless(len(request) > 2, Nrc.INCORRECT_LENGTH)
    c.check_conditions()
    c.security.try_key(level, request[2:], c.now_ns)
    return bytes([number])


SERVICE = Service(
    0x27,
    "SecurityAccess",
    _handle,
    _sub_functions,
    shortest=2,
    sessions=NOT_DEFAULT,
    action="unlock",
    traced=lambda request: len(request) > 1 and request[1] % 2 == 0,  # a key; asking for a seed does nothing yet
    offered=lambda c: bool(c.security.levels),
)
