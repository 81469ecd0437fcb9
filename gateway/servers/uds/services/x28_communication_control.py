"""0x28 CommunicationControl (ISO 14229-1, 9.5): normal messages on and off, both ways.

Frames that the gateway sends of its own accord (DTC frames, J1939 messages, monitors' values) are normal communication;
answers are not. With reception off the monitors see nothing, and no test result counts, as a silent bus would otherwise
look like many faults. There is no network management here, which is accepted and changes nothing.
"""

from __future__ import annotations

from gateway.servers.uds.context import NOT_DEFAULT, Context, Service
from gateway.servers.uds.nrc import Nrc, refuse_unless

#: Sub-function -> (receive, send).
_SETTINGS = {0x00: (True, True), 0x01: (True, False), 0x02: (False, True), 0x03: (False, False)}
_NORMAL = 0x01


def _handle(c: Context, request: bytes) -> bytes:
    number, kind = request[1] & 0x7F, request[2]
    refuse_unless(kind & 0x03 != 0 and kind & 0x0C == 0, Nrc.REQUEST_OUT_OF_RANGE)
    refuse_unless(kind >> 4 in (0x0, 0xF), Nrc.REQUEST_OUT_OF_RANGE)  # all networks, or this one
    c.check_conditions()
    if kind & _NORMAL:
        receive, send = _SETTINGS[number]
        c.holder.set_communication(receive=receive, send=send)
    return bytes([number])


SERVICE = Service(
    0x28,
    "CommunicationControl",
    _handle,
    lambda _: dict.fromkeys(_SETTINGS, NOT_DEFAULT),
    shortest=3,
    longest=3,
    sessions=NOT_DEFAULT,
    action="communication",
    traced=lambda _: True,
    undoes=lambda request: request[1:2] in (b"\x00", b"\x80"),
)
