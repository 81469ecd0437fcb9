"""The entity's answers by UDP: who it is, how it does, whether the vehicle is ready (ISO 13400-2:2019, 7.4 and 9.4)."""

from __future__ import annotations

from collections.abc import Callable

from gateway_testers.doip.codec import BY_UDP, HEADER, VERSIONS, HeaderNack, Kind, Refused, packed, refusal
from gateway_testers.doip.params import DoipParams

#: Data identifier of the VIN (ISO 14229-1, C.1).
VIN = 0xF190
#: Node types, power modes.
GATEWAY, NODE = 0x00, 0x01
NOT_READY, READY, NOT_SUPPORTED = 0x00, 0x01, 0x02
#: VIN and GID: known, or not yet.
SYNCHRONIZED, INCOMPLETE = 0x00, 0x10


class Identity:
    """Answers datagrams.

    Args:
        params: its settings.
        read: reads a data identifier; None: there is none.
        ready: whether the vehicle is ready for diagnostics; None: it is not known.
        node: GATEWAY or NODE.
    """

    def __init__(
        self,
        params: DoipParams,
        read: Callable[[int], bytes | None],
        ready: Callable[[], bool] | None,
        node: int,
    ) -> None:
        self._params, self._read, self._ready, self._node = params, read, ready, node
        self._eid, self._gid = bytes.fromhex(params.eid), bytes.fromhex(params.gid)

    @property
    def vin(self) -> bytes:
        """The VIN, shape (17,); zeros: it is not known."""
        found = self._params.vin.encode() if self._params.vin is not None else self._read(VIN)
        return found if found is not None and len(found) == 17 else bytes(17)

    def vehicle(self, version: int = VERSIONS[-1]) -> bytes:
        """Return the vehicle announcement, which is also the answer to identification requests."""
        vin = self.vin
        sync = SYNCHRONIZED if any(vin) else INCOMPLETE
        own = self._params.address.to_bytes(2, "big")
        return packed(Kind.VEHICLE, vin + own + self._eid + self._gid + bytes([0x00, sync]), version)

    def answer(self, datagram: bytes, sockets: int) -> bytes:
        """Return the answer to a datagram; b"": none is due, as to answers of others."""
        if len(datagram) < HEADER.size:
            return b""
        found = refusal(datagram, BY_UDP, self._params.most_bytes, self._params.most_bytes)
        if isinstance(found, Refused):
            # Two entities must not refuse each other's refusals for ever.
            return b"" if HEADER.unpack_from(datagram)[2] == Kind.NACK else found.packed()
        kind, length, version = found
        body = datagram[HEADER.size :]
        if len(body) != length:
            return Refused(HeaderNack.INVALID_LENGTH, version).packed()
        asked = {Kind.IDENTIFY: b"", Kind.IDENTIFY_BY_EID: self._eid, Kind.IDENTIFY_BY_VIN: self.vin}
        if kind in asked:
            return self.vehicle(version) if body == asked[kind] else b""
        if kind == Kind.STATUS_REQUEST:
            most, size = self._params.connections, self._params.most_bytes
            return packed(Kind.STATUS, bytes([self._node, most, min(sockets, most)]) + size.to_bytes(4, "big"), version)
        if kind == Kind.POWER_REQUEST:
            mode = NOT_SUPPORTED if self._ready is None else READY if self._ready() else NOT_READY
            return packed(Kind.POWER, bytes([mode]), version)
        return b""
