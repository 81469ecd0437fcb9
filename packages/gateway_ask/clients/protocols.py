"""How an ECU is asked by OBD: classic OBD (SAE J1979) or OBD on UDS (SAE J1979-2), as it answers.

Requests of OBD on UDS for DTCs are those of ISO 14229-1:2020 (0x19 42 and 55) for the emission system, group 0x33.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from gateway.common.times import NEVER
from gateway.config.ecu import AUTO, OBD, ON_UDS, UDS, EcuParams, ReadParams
from gateway.faults.settings import ConditionSettings
from gateway_ask.answers.obd_on_uds import on_uds
from gateway_ask.clients.ask import Ask, Turns
from gateway_ask.clients.ecu import MS

#: DTCs that fail, did in this cycle or since the clear, are pending, confirmed, or ask for a lamp; confirmed; pending.
_ANY, _CONFIRMED, _PENDING = 0xAF, 0x08, 0x04
#: The emission system; all severities and classes; the four classes of ISO 27145, where an ECU wants them named.
_EMISSION, _ALL, _CLASSES = 0x33, 0xFF, 0x1E
_BY_MASK, _MODES = b"\x19\x02\xaf", (b"\x03", b"\x07", b"\x0a")


def _of_group(severity: int, *masks: int) -> tuple[bytes, ...]:
    """Return requests for the DTCs of the emission system with bits of these masks, one each."""
    return tuple(bytes([0x19, 0x42, _EMISSION, mask, severity]) for mask in masks)


#: The same for DTCs with a status of any kind; where that is refused, for those that are confirmed, and pending.
_GROUP: Turns = (_of_group(_ALL, _ANY), *(_of_group(each, _CONFIRMED, _PENDING) for each in (_ALL, _CLASSES)))
_PERMANENT = bytes([0x19, 0x55, _EMISSION])

#: Requests for DTCs, each with what is asked instead where it is refused for good.
_Requests = tuple[tuple[bytes, Turns], ...]
#: Protocol -> requests for DTCs.
DTC_REQUESTS: dict[str, _Requests] = {
    UDS: ((_BY_MASK, ()),),
    OBD: tuple((mode, ()) for mode in _MODES),
    ON_UDS: ((_GROUP[0][0], _GROUP[1:]), (_PERMANENT, ())),
}
#: Protocol of OBD -> the same where it was found: UDS tells failure types, which classic OBD does not.
_FOUND: dict[str, _Requests] = {
    OBD: ((_BY_MASK, (_MODES,)),),
    ON_UDS: ((_GROUP[0][0], (*_GROUP[1:], (_BY_MASK,))), (_PERMANENT, ())),
}


class Schedule(NamedTuple):
    """Requests to an ECU.

    Attributes:
        asks: that are known.
        open: by the protocol of OBD that it speaks, where that is to be found.
    """

    asks: list[Ask]
    open: Mapping[str, list[Ask]]


#: Whether signals are in their ranges now.
Meets = Callable[[Sequence[ConditionSettings]], bool]


def schedule_of(params: EcuParams, meets: Meets = lambda _: True) -> Schedule:
    """Return what an ECU is asked.

    Args:
        params: of the ECU.
        meets: judges the conditions of its requests.
    """
    asks = [_ask_of(read, read.request, meets) for read in params.read if not read.is_obd]
    if params.dtcs is not None and params.dtc_protocol == UDS:
        asks += _asks_of_dtcs(params, DTC_REQUESTS[UDS], meets)
    if params.finds_protocol:
        found = {protocol: _asks_of_obd(params, protocol, meets) for protocol in (ON_UDS, OBD)}
        return Schedule(asks, {name: [replace(ask, protocol=name) for ask in each] for name, each in found.items()})
    return Schedule([*asks, *_asks_of_obd(params, params.protocol, meets)], {})


def _asks_of_obd(params: EcuParams, protocol: str, meets: Meets) -> Iterator[Ask]:
    """Yield what is asked by a protocol of OBD: values, DTCs."""
    for read in params.read:
        if read.is_obd:
            forms = [read.request, _request(*on_uds(*read.key))]
            if protocol == ON_UDS:
                forms.reverse()
            instead = ((forms[1],),) if params.finds_protocol else ()  # it may answer both, each in part
            yield replace(_ask_of(read, forms[0], meets), instead=instead)
    if params.dtc_protocol == AUTO:
        yield from _asks_of_dtcs(params, _FOUND[protocol], meets)
    elif params.dtc_protocol != UDS:
        yield from _asks_of_dtcs(params, DTC_REQUESTS[params.dtc_protocol], meets)


def _request(service: int, identifier: int) -> bytes:
    return bytes([service, *identifier.to_bytes(2, "big")])


def _ask_of(read: ReadParams, request: bytes, meets: Meets) -> Ask:
    every_ns = NEVER if read.apart_ms is None else round(read.apart_ms * MS)
    return Ask(request, every_ns, ready=partial(meets, read.when), on=read.on or "")


def _asks_of_dtcs(params: EcuParams, found: _Requests, meets: Meets) -> Iterator[Ask]:
    if params.dtcs is not None:
        every_ns = round(params.dtcs.every_s * 1000 * MS)
        for request, instead in found:
            yield Ask(request, every_ns, instead=instead, ready=partial(meets, params.dtcs.when))
