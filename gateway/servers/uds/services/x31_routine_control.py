"""0x31 RoutineControl (ISO 14229-1, 13.2): services for a bench beside reading and clearing.

| routine | does |
|---|---|
| 0x0201 | ends the operation cycle and begins the next one |
| 0x0202 | checks the fault memory's file and compacts it (answers 0x78 first) |

Both end by themselves, so there is no stopRoutine.
"""

from __future__ import annotations

from gateway.servers.uds.context import ANY_SESSION, Context, Later, Service
from gateway.servers.uds.nrc import NegativeError, Nrc, refuse_unless
from gateway_fdi.errors import GatewayError

START, RESULTS = 0x01, 0x03
RESTART_CYCLE, COMPACT = 0x0201, 0x0202
DONE = b"\x00"


def _handle(c: Context, request: bytes) -> bytes | Later:
    number, routine = request[1] & 0x7F, int.from_bytes(request[2:4], "big")
    refuse_unless(routine in (RESTART_CYCLE, COMPACT), Nrc.REQUEST_OUT_OF_RANGE)
    c.check_security()
    refuse_unless(number in (START, RESULTS), Nrc.SUB_FUNCTION_NOT_SUPPORTED)
    refuse_unless(len(request) == 4, Nrc.INCORRECT_LENGTH)
    c.check_conditions()
    echo = bytes([number]) + request[2:4]
    if number == RESULTS:
        refuse_unless(routine in c.routines_done, Nrc.REQUEST_SEQUENCE_ERROR)
        return echo + c.routines_done[routine]
    if routine == RESTART_CYCLE:
        c.control.restart_cycle()
        c.routines_done[routine] = DONE
        return echo + DONE

    def compact() -> bytes:
        try:
            c.control.compact()
        except GatewayError as error:
            raise NegativeError(Nrc.GENERAL_PROGRAMMING_FAILURE) from error
        c.routines_done[routine] = DONE
        return echo + DONE

    return Later(compact)


SERVICE = Service(
    0x31,
    "RoutineControl",
    _handle,
    lambda _: dict.fromkeys(range(0x80), ANY_SESSION),  # which there are is asked of the routine, after its identifier
    shortest=4,
    action="routine",
    traced=lambda request: request[1:2] not in (b"\x03", b"\x83"),
    late=True,
)
