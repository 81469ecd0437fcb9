"""Authentication by certificate (ISO 14229-1, 0x29, APCE): proof of the tester's identity.

A tester shows a certificate that a configured root vouches for (see ``certificates``), and proves by a signature
over a challenge that it has the certificate's private key. Its rights go by its role. Keys are Ed25519, ECDSA
over SHA-256, or RSA-PSS over SHA-256. A gateway keeps no private key, and nothing that must be secret.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import Field

from gateway.servers.uds.attempts import Attempts
from gateway.servers.uds.certificates import Certificates
from gateway.servers.uds.nrc import NegativeError, Nrc
from gateway_fdi.common.tomlfile import StrictModel

#: Bytes of the gateway's challenge.
CHALLENGE = 32


class AuthenticationParams(StrictModel):
    """Authentication by certificate."""

    roots: tuple[Path, ...] = Field(
        min_length=1,
        description="certificates (PEM) that sign those of testers, themselves or through others; relative to this"
        " configuration",
    )
    roles: tuple[str, ...] = Field(
        min_length=1, description="roles that there are: organizational units of testers' certificates"
    )
    revoked: tuple[int, ...] = Field((), description="serial numbers of certificates that are not good any more")
    attempts: int = Field(
        5, ge=1, le=255, description="certificates shown without a right proof after them, before the delay"
    )
    delay_s: float = Field(10.0, gt=0, le=3600, description="delay after them, for all testers [s]")


class Authentication:
    """State of authentication of one tester.

    Args:
        params: settings; None: it is not offered.
        random: gives a challenge of a number of bytes.

    Raises:
        InputError: a root cannot be read, or may not sign; or cryptography is not installed.
    """

    def __init__(
        self, params: AuthenticationParams | None, random: Callable[[int], bytes] = secrets.token_bytes
    ) -> None:
        self._random = random
        self._certificates = None if params is None else Certificates(params.roots, params.roles, params.revoked)
        self._attempts = None if params is None else Attempts("authentication", params.attempts, params.delay_s)
        self._pending: tuple[Any, str, bytes] | None = None  # public key, role, bytes to be signed
        self.role = ""

    @property
    def offered(self) -> bool:
        """Whether there are roots."""
        return self._certificates is not None

    def beside(self) -> Authentication:
        """Return the authentication of another tester: a role of its own, but wrong attempts count for both."""
        other = Authentication(None, self._random)
        other._certificates, other._attempts = self._certificates, self._attempts
        return other

    @property
    def attempts(self) -> list[Attempts]:
        """Attempts to prove a role, of all testers."""
        return [] if self._attempts is None else [self._attempts]

    def end(self) -> None:
        """Forget who the tester is."""
        self._pending, self.role = None, ""

    def challenge(self, certificate: bytes, challenge: bytes, wall_ns: int, t_ns: int) -> bytes:
        """Take a tester's certificate and challenge, which begins an attempt; returns the gateway's challenge.

        Args:
            certificate: X.509, DER; after it those between it and a root, each of which has signed the one before.
            challenge: of the tester; may be empty.
            wall_ns: now, for the certificate's validity.
            t_ns: now, for attempts and their delay.

        Raises:
            NegativeError: the certificate is not good, and why; or there were too many attempts.
        """
        self._pending = None
        assert self._certificates is not None, "not offered"
        assert self._attempts is not None, "not offered"
        self._attempts.check(t_ns)
        self._attempts.look(t_ns)
        self._attempts.begin(t_ns)
        try:
            key, role = self._certificates.verified(certificate, datetime.fromtimestamp(wall_ns / 1e9, UTC))
        except NegativeError as error:
            self._attempts.fail(t_ns, error.nrc)
        ours = self._random(CHALLENGE)
        self._pending = key, role, ours + challenge
        return ours

    def prove(self, proof: bytes, t_ns: int) -> None:
        """Take the signature over our challenge and the tester's, in this order, which ends the attempt.

        Args:
            proof: the signature.
            t_ns: now, for attempts and their delay.

        Raises:
            NegativeError: none was asked for, it is not the certificate's, or there were too many attempts.
        """
        if self._pending is None:
            raise NegativeError(Nrc.REQUEST_SEQUENCE_ERROR)
        assert self._attempts is not None, "not offered"
        self._attempts.check(t_ns)
        self._attempts.look(t_ns)
        (key, role, signed), self._pending = self._pending, None
        if not _is_signed(key, proof, signed):
            self._attempts.fail(t_ns, Nrc.OWNERSHIP_NOT_PROVEN)
        self._attempts.forgive()
        self.role = role


def _is_signed(key: Any, signature: bytes, data: bytes) -> bool:
    """Return whether a signature is the key's."""
    from cryptography.exceptions import InvalidSignature  # noqa: PLC0415 - an extra, and slow to load
    from cryptography.hazmat.primitives import hashes  # noqa: PLC0415 - likewise
    from cryptography.hazmat.primitives.asymmetric import ec, ed25519, padding  # noqa: PLC0415 - likewise

    try:
        if isinstance(key, ed25519.Ed25519PublicKey):
            key.verify(signature, data)
        elif isinstance(key, ec.EllipticCurvePublicKey):
            key.verify(signature, data, ec.ECDSA(hashes.SHA256()))
        else:
            pss = padding.PSS(padding.MGF1(hashes.SHA256()), padding.PSS.AUTO)
            key.verify(signature, data, pss, hashes.SHA256())
    except InvalidSignature:
        return False
    return True
