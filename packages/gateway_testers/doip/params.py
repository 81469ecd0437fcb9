"""Settings of the DoIP server: the table ``[output.doip]``."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Self

from pydantic import Field, field_validator, model_validator

from gateway.faults.settings import ConditionSettings
from gateway_fdi.common.tomlfile import StrictModel

#: Addresses of external testers (ISO 13400-2, Table 13).
TESTERS = (0x0E00, 0x0FFF)
#: Bytes before the request in a diagnostic message: source and target.
ADDRESSES = 4


class DoipTesterParams(StrictModel):
    """Source addresses of testers."""

    address: int = Field(ge=0x0001, le=0xDFFF, description="source address of a tester, or the first of several")
    last: int | None = Field(None, ge=0x0001, le=0xDFFF, description="the last of them; none: there is one")
    certificate: str | None = Field(
        None, min_length=1, description="common name of the TLS certificate that it needs; none: it needs none"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.last is not None and self.last < self.address:
            raise ValueError("last is before address")
        return self

    def has(self, source: int) -> bool:
        """Return whether a source address is among them."""
        return self.address <= source <= (self.last or self.address)


class TlsParams(StrictModel):
    """TLS 1.2 and 1.3."""

    certificate: Path = Field(description="certificate of the gateway with its chain (PEM); relative to this file")
    key: Path = Field(description="its private key (PEM)")
    client_ca: Path | None = Field(None, description="certificates (PEM) that sign those of testers")
    port: int = Field(3496, ge=1, le=65535, description="TCP port")
    required: bool = Field(True, description="false: testers may come without TLS, too")


class RouteParams(StrictModel):
    """A route to an ECU."""

    ecu: str = Field(description="name of an [[ecu]]")
    address: int = Field(ge=0x0001, le=0xDFFF, description="its logical address")
    requests_per_s: float = Field(50.0, gt=0, le=1000, description="most requests a second, of all testers")


class DoipParams(StrictModel):
    """The DoIP server."""

    bind: tuple[str, ...] = Field(
        ("127.0.0.1", "::1"), min_length=1, description="addresses of this machine at which it listens"
    )
    port: int = Field(13400, ge=1, le=65535, description="TCP and UDP port")
    address: int = Field(0x1000, ge=0x0001, le=0xDFFF, description="logical address of the gateway")
    functional: int = Field(0xE400, ge=0xE400, le=0xEFFF, description="functional address: the gateway and all routes")
    tester: tuple[DoipTesterParams, ...] = Field(
        (DoipTesterParams(address=TESTERS[0], last=TESTERS[1]),), min_length=1, description="testers that may come"
    )
    vin: str | None = Field(
        None, pattern=r"^[A-HJ-NPR-Z0-9]{17}$", description="default: data identifier 0xF190, if it has 17 characters"
    )
    eid: str = Field("0" * 12, pattern=r"^[0-9A-Fa-f]{12}$", description="entity, as a MAC address; zeros: not set")
    gid: str = Field("0" * 12, pattern=r"^[0-9A-Fa-f]{12}$", description="group of entities; zeros: not set")
    announce: tuple[str, ...] = Field(
        (), description="IP addresses that the vehicle is announced to at the start; none: it is not announced"
    )
    connections: int = Field(4, ge=1, le=64, description="testers at a time")
    most_bytes: int = Field(
        65536, ge=4099, le=1 << 20, description="longest message of a tester, longest answer [byte]"
    )
    ready: tuple[ConditionSettings, ...] = Field(
        (), description="power mode: ready for diagnostics while all are met; none: power mode is not supported"
    )
    route: tuple[RouteParams, ...] = Field((), description="ECUs that testers reach by it")
    tls: TlsParams | None = Field(None, description="TLS; none: it is not offered")

    @field_validator("bind", "announce")
    @classmethod
    def _addresses(cls, given: tuple[str, ...]) -> tuple[str, ...]:
        for text in given:
            try:
                ipaddress.ip_address(text)
            except ValueError as error:
                raise ValueError(f"{text!r} is no IP address") from error
        return given

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        taken = {self.address: "address"}
        for k, route in enumerate(self.route):
            owner = taken.setdefault(route.address, f"route[{k}].address")
            if owner != f"route[{k}].address":
                raise ValueError(f"route[{k}].address 0x{route.address:04X}: {owner} is this, too")
        for address, owner in taken.items():
            if any(entry.has(address) for entry in self.tester):
                raise ValueError(f"{owner} 0x{address:04X} is one of the testers'")
        if any(entry.certificate for entry in self.tester) and (self.tls is None or self.tls.client_ca is None):
            raise ValueError("a tester needs a certificate: give tls with client_ca")
        if any(condition.rise for condition in self.ready):
            raise ValueError("rise is for operation cycles, not for power mode")
        bound = [ipaddress.ip_address(text) for text in self.bind]
        for text in self.announce:
            to = ipaddress.ip_address(text)
            if not any(one.version == to.version and not one.is_unspecified for one in bound):
                raise ValueError(
                    f"announce {text!r} needs an address of that kind in bind: it goes out by that interface"
                )
            if to.is_multicast:
                raise ValueError(f"announce {text!r}: a single machine, or the broadcast address of a network")
        return self

    def tester_of(self, source: int) -> DoipTesterParams | None:
        """Return the entry that has a source address; None: nobody with it may come."""
        return next((entry for entry in self.tester if entry.has(source)), None)

    def is_place_of(self, other: DoipParams | None) -> bool:
        """Return whether other settings have the same sockets."""
        ports = [None if each is None or each.tls is None else each.tls.port for each in (self, other)]
        same = other is not None and (self.bind, self.port) == (other.bind, other.port)
        return same and ports[0] == ports[1]
