"""Settings of the UDS server."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from gateway.bus.frames import EXTENDED, ID_MASK
from gateway.isotp.addressing import FUNCTIONAL, AddressingParams
from gateway.isotp.params import IsoTpParams
from gateway.servers.access import Access
from gateway.servers.uds.authentication import AuthenticationParams
from gateway_fdi.common.tomlfile import StrictModel

#: Shorter seeds come again while an attacker listens.
LEAST_SEED = 8
#: A session without requests ends after this (ISO 14229-2, S3) [ms].
S3_MS = 5000


class SecurityLevel(StrictModel):
    """One security level (0x27): how its key is made of its seed."""

    level: int = Field(ge=1, le=33, description="level n: seed by sub-function 2n-1, key by 2n")
    key: str = Field(
        "hmac_sha256",
        description='"hmac_sha256", or "package.module:function" of (seed, secret, level) -> key',
    )
    secret: str = Field(description="secret of the key function, as hex digits")
    seed_length: int = Field(8, ge=2, le=64, description="bytes of the seed")
    attempts: int = Field(3, ge=1, le=255, description="wrong keys before the delay")
    delay_s: float = Field(10.0, gt=0, le=3600, description="delay after them [s]")
    start_delay_s: float = Field(
        0.0, ge=0, le=3600, description="delay after each start of the gateway, from the first request on [s]"
    )

    @model_validator(mode="after")
    def _a_secret(self) -> Self:
        try:
            bytes.fromhex(self.secret)
        except ValueError as error:
            raise ValueError("secret: an even number of hex digits") from error
        return self


class BusRouteParams(AddressingParams):
    """A route to an ECU of another bus, and its identifiers on the bus of the testers."""

    ecu: str = Field(description="name of an [[ecu]]")
    requests_per_s: float = Field(50.0, gt=0, le=1000, description="most requests a second, of all testers")

    def transport(self, own: IsoTpParams) -> IsoTpParams:
        """Return its identifiers and transport.

        Args:
            own: of the gateway's own address; identifiers of another length have the usual functional one.
        """
        request, response, target, _ = self.place
        flag = request & EXTENDED
        functional = own.functional if own.flags == flag else FUNCTIONAL[bool(flag)] & ID_MASK
        return IsoTpParams(
            bus=own.bus,
            request=request & ID_MASK,
            response=response & ID_MASK,
            functional=None if target is not None or own.functional is None else functional,
            extended=bool(flag),
            fd=own.fd,
            padding=own.padding,
            block_size=own.block_size,
            separation_ms=own.separation_ms,
        )


class FurtherAddress(StrictModel):
    """A further address of the UDS server, with a session and a security of its own."""

    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    request: int = Field(ge=0, le=0x1FFFFFFF, description="identifier of physical requests")
    response: int = Field(ge=0, le=0x1FFFFFFF, description="identifier of the answers")
    functional: int | None = Field(None, ge=0, le=0x1FFFFFFF, description="identifier of functional requests")
    route: tuple[BusRouteParams, ...] = Field((), description="ECUs of other buses that its testers reach")


class UdsParams(IsoTpParams):
    """The UDS server."""

    p2_ms: int = Field(50, ge=1, le=65535, description="longest time to an answer [ms]")
    p2_star_ms: int = Field(5000, ge=10, le=655350, description="longest time to an answer after 0x78 [ms]")
    s3_ms: int = Field(S3_MS, ge=10, le=600000, description="a session without requests ends after this [ms]")
    status_mask: int = Field(0xFF, ge=1, le=255, description="status bits that it shows")
    clear: Access | None = Field(None, description="conditions of clearing (0x14); the same as access.clear")
    write: Access | None = Field(None, description="conditions of writing (0x2E); the same as access.write")
    routine: Access | None = Field(None, description="conditions of routines (0x31); the same as access.routine")
    security: tuple[SecurityLevel, ...] = Field((), description="security levels (0x27)")
    authentication: AuthenticationParams | None = Field(None, description="authentication by certificate (0x29)")
    route: tuple[BusRouteParams, ...] = Field((), description="ECUs of other buses that testers reach by this one")
    further: tuple[FurtherAddress, ...] = Field(
        (), description="further addresses, for testers beside the first; each has its own session"
    )

    @model_validator(mode="after")
    def _known_levels(self) -> Self:
        levels = [entry.level for entry in self.security]
        if len(set(levels)) != len(levels):
            raise ValueError("security: two entries have one level")
        for name, rule in self.rules.items():
            if rule.security and rule.security not in levels:
                raise ValueError(f"{name}.security: no security level {rule.security} is set up")
        return self

    @property
    def each_address(self) -> list[UdsParams]:
        """The server's settings for each of its addresses, the first one first."""
        names = FurtherAddress.model_fields
        return [self, *(self.model_copy(update={name: getattr(one, name) for name in names}) for one in self.further)]

    @property
    def rules(self) -> dict[str, Access]:
        """Rules of access that are given here, rather than in the table ``[access]``."""
        named = {"clear": self.clear, "write": self.write, "routine": self.routine}
        return {name: rule for name, rule in named.items() if rule is not None}

    def weak_levels(self) -> list[str]:
        """Return what is weak about the security levels, one line each."""
        return [
            f"output.uds.security[{k}].seed_length = {entry.seed_length}: a seed comes again soon; take 8 or more"
            for k, entry in enumerate(self.security)
            if entry.seed_length < LEAST_SEED
        ]

    @property
    def roles(self) -> list[str]:
        """Roles that there are."""
        return [] if self.authentication is None else list(self.authentication.roles)

    @property
    def levels(self) -> list[int]:
        """Security levels that there are."""
        return sorted(entry.level for entry in self.security)
