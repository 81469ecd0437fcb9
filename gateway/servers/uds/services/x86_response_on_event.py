"""0x86 ResponseOnEvent (ISO 14229-1, 10.9): an answer whenever a DTC's status changes.

Set up with the status mask of interest and the service to respond to (0x19 or 0x22), then started; it ends with
its window or with the session that set it up. Nothing is stored over a restart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gateway.faults.entries import DtcChange
from gateway.servers.uds.context import ANY_SESSION, Context, EventLogic, Service
from gateway.servers.uds.nrc import Nrc, refuse_unless

STOP, ON_DTC_STATUS_CHANGE, REPORT, START, CLEAR = 0x00, 0x01, 0x04, 0x05, 0x06
#: The window of time for ever; others count in units of 10 s here.
INFINITE, UNIT_NS = 0x02, 10_000_000_000
#: Services that may be the answer.
ANSWERS = (0x19, 0x22)


def _handle(c: Context, request: bytes) -> bytes:
    number, window = request[1] & 0x7F, request[2]
    events = c.events
    if number == ON_DTC_STATUS_CHANGE:
        refuse_unless(len(request) >= 6, Nrc.INCORRECT_LENGTH)
        refuse_unless(window != 0 and request[4] in ANSWERS, Nrc.REQUEST_OUT_OF_RANGE)
        c.check_conditions()
        c.events = EventLogic((request[3], request[4:]), window)
        return bytes([number, 0]) + request[2:]
    refuse_unless(len(request) == 3, Nrc.INCORRECT_LENGTH)
    if number == CLEAR:
        c.events = EventLogic()
    elif number == REPORT:
        if not events.started or events.set_up is None:
            return bytes([number, 0])
        mask, service = events.set_up
        return bytes([number, 1, ON_DTC_STATUS_CHANGE, events.window, mask]) + service
    else:
        c.check_conditions()
        refuse_unless(events.set_up is not None, Nrc.REQUEST_SEQUENCE_ERROR)
        events.started = number == START
        infinite = events.window == INFINITE
        events.until_ns = None if infinite else c.now_ns + events.window * UNIT_NS
    return bytes([number, 0, window])


def responses_to(c: Context, changes: Sequence[DtcChange]) -> Iterator[bytes]:
    """Yield the requests to be answered now, one for each change of a status bit that is waited for."""
    events = c.events
    if not events.started or events.set_up is None:
        return
    if events.until_ns is not None and c.now_ns > events.until_ns:
        events.started = False
        return
    mask, service = events.set_up
    for change in changes:
        if (change.old_status ^ change.new_status) & mask:
            yield service


SERVICE = Service(
    0x86,
    "ResponseOnEvent",
    _handle,
    lambda _: dict.fromkeys((STOP, ON_DTC_STATUS_CHANGE, REPORT, START, CLEAR), ANY_SESSION),
    shortest=3,
    action="events",
    undoes=lambda request: request[1:2] in (b"\x00", b"\x80", b"\x06", b"\x86"),
)
