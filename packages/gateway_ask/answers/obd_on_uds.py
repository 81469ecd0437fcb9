"""OBD on UDS (SAE J1979-2): identifiers of service 0x22 that stand for those of classic OBD (SAE J1979).

ISO 14229-1, Annex C.1 gives the pages: 0xF400 the PIDs of service 0x01, 0xF600 the monitors of service 0x06, 0xF800 the
infotypes of service 0x09. Of 0xF500, PIDs from 0x100 on, no layout is public.
"""

from __future__ import annotations

from gateway.config.ecu import PAGES

_SERVICES = {page >> 8: service for service, page in PAGES.items()}
#: Bytes of a record of service 0x06 after its monitor: test, scaling, value, least and greatest value.
RECORD = 8


def on_uds(service: int, identifier: int) -> tuple[int, int]:
    """Return service and identifier of OBD on UDS that stand for those of classic OBD."""
    return 0x22, PAGES[service] | identifier


def classic(service: int, identifier: int) -> tuple[int, int] | None:
    """Return service and identifier of classic OBD that those of OBD on UDS stand for; None: they are none of these."""
    found = _SERVICES.get(identifier >> 8) if service == 0x22 else None
    return None if found is None else (found, identifier & 0xFF)


def classic_length(service: int, length: int) -> int:
    """Return how many bytes an answer of OBD on UDS has, where classic OBD has a layout of some [byte]."""
    return length - (service == 0x09)


def as_classic(service: int, identifier: int, data: bytes) -> bytes:
    """Return what stands after the identifier in classic OBD, on CAN.

    Args:
        service: of classic OBD.
        identifier: of classic OBD.
        data: what stands after it in OBD on UDS.
    """
    if service == 0x09:  # infotypes say how many items follow: a mask of what there is, one
        return b"\x01" + data
    if (
        service == 0x06 and identifier % 0x20 and len(data) % RECORD == 0
    ):  # each record but the first repeats the monitor
        return bytes([identifier]).join(data[k : k + RECORD] for k in range(0, len(data), RECORD))
    return data
