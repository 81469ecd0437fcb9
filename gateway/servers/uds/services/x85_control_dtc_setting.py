"""0x85 ControlDTCSetting (ISO 14229-1, 9.10): status bytes are updated or frozen; on again by default."""

from __future__ import annotations

from gateway.faults.dtc import ALL_DTCS
from gateway.servers.uds.context import NOT_DEFAULT, Context, Service
from gateway.servers.uds.nrc import Nrc, refuse_unless

ON, OFF = 0x01, 0x02


def _handle(c: Context, request: bytes) -> bytes:
    number, option = request[1] & 0x7F, request[2:]
    refuse_unless(len(option) in (0, 3), Nrc.INCORRECT_LENGTH)
    refuse_unless(option in (b"", ALL_DTCS.to_bytes(3, "big")), Nrc.REQUEST_OUT_OF_RANGE)
    c.check_conditions()
    c.holder.set_dtcs(number == ON)
    return bytes([number])


SERVICE = Service(
    0x85,
    "ControlDTCSetting",
    _handle,
    lambda _: dict.fromkeys((ON, OFF), NOT_DEFAULT),
    shortest=2,
    sessions=NOT_DEFAULT,
    action="dtc_setting",
    traced=lambda _: True,
    undoes=lambda request: request[1:2] in (b"\x01", b"\x81"),
)
