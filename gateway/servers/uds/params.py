"""Settings of the UDS server."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from gateway.common.tomlfile import StrictModel
from gateway.servers.isotp.params import IsoTpParams

#: Diagnostic sessions by name (ISO 14229-1, 0x10).
SESSIONS = {"default": 0x01, "extended": 0x03}


class Access(StrictModel):
    """In which sessions something is allowed, and at which security level."""

    sessions: tuple[Literal["default", "extended"], ...] = Field(
        ("default", "extended"), min_length=1, description="sessions in which it is allowed"
    )
    security: int = Field(0, ge=0, le=33, description="security level that it needs, 0: none")

    def in_session(self, session: int) -> bool:
        """Tell whether it is allowed in a session."""
        return session in {SESSIONS[name] for name in self.sessions}


class SecurityLevel(StrictModel):
    """One security level (0x27): how its key is made of its seed."""

    level: int = Field(ge=1, le=33, description="level n: seed by sub-function 2n-1, key by 2n")
    key: str = Field(
        "hmac_sha256",
        description='"hmac_sha256", or "package.module:function" of (seed, secret, level) -> key',
    )
    secret: str = Field(description="secret of the key function, as hex digits")
    seed_length: int = Field(4, ge=2, le=32, description="bytes of the seed")
    attempts: int = Field(3, ge=1, le=255, description="wrong keys before the delay")
    delay_s: float = Field(10.0, gt=0, le=3600, description="delay after them [s]")

    @model_validator(mode="after")
    def _a_secret(self) -> Self:
        try:
            bytes.fromhex(self.secret)
        except ValueError as error:
            raise ValueError("secret: an even number of hex digits") from error
        return self


class UdsParams(IsoTpParams):
    """The UDS server."""

    p2_ms: int = Field(50, ge=1, le=65535, description="longest time to an answer [ms]")
    p2_star_ms: int = Field(5000, ge=10, le=655350, description="longest time to an answer after 0x78 [ms]")
    s3_ms: int = Field(5000, ge=10, le=600000, description="a session without requests ends after this [ms]")
    status_mask: int = Field(0xFF, ge=1, le=255, description="status bits that it shows")
    clear: Access = Field(Access(), description="what clearing (0x14) needs")
    write: Access = Field(Access(sessions=("extended",)), description="what writing (0x2E) needs")
    routine: Access = Field(Access(sessions=("extended",)), description="what routines (0x31) need")
    security: tuple[SecurityLevel, ...] = Field((), description="security levels (0x27)")

    @model_validator(mode="after")
    def _known_levels(self) -> Self:
        levels = [entry.level for entry in self.security]
        if len(set(levels)) != len(levels):
            raise ValueError("security: two entries have one level")
        for name in ("clear", "write", "routine"):
            needed = getattr(self, name).security
            if needed and needed not in levels:
                raise ValueError(f"{name}.security: no security level {needed} is set up")
        return self
