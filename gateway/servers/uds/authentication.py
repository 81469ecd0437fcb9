"""Authentication by certificate (ISO 14229-1, 0x29, APCE): who the tester is, rather than that it knows a secret.

A tester shows a certificate that one of the configured roots has signed, and proves by a signature over a challenge
that it has the certificate's private key. What it may do goes by its role: the organizational unit (OU) of its
subject. Keys are Ed25519, ECDSA over SHA-256, or RSA-PSS over SHA-256. A gateway keeps no private key, and nothing
that must be secret.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import Field

from gateway.common.extras import need
from gateway.common.tomlfile import StrictModel
from gateway.errors import InputError
from gateway.servers.uds.nrc import NegativeError, Nrc, refuse_unless

#: Bytes of the gateway's challenge.
CHALLENGE = 32


class AuthenticationParams(StrictModel):
    """Authentication by certificate."""

    roots: tuple[Path, ...] = Field(
        min_length=1, description="certificates (PEM) that sign those of testers; relative to this configuration"
    )
    roles: tuple[str, ...] = Field(
        min_length=1, description="roles that there are: organizational units of testers' certificates"
    )
    revoked: tuple[int, ...] = Field((), description="serial numbers of certificates that are not good any more")


class Authentication:
    """State of authentication of one tester.

    Args:
        params: settings; None: it is not offered.
        random: gives a challenge of so many bytes.

    Raises:
        InputErrors: a root that cannot be read.
    """

    def __init__(
        self, params: AuthenticationParams | None, random: Callable[[int], bytes] = secrets.token_bytes
    ) -> None:
        self._params, self._random = params, random
        self._roots = [] if params is None else _roots(params)
        self._pending: tuple[Any, str, bytes] | None = None  # public key, role, what is to be signed
        self.role = ""

    @property
    def offered(self) -> bool:
        """Whether there are roots."""
        return bool(self._roots)

    def beside(self) -> Authentication:
        """Return the authentication of another tester."""
        other = Authentication(None, self._random)
        other._params, other._roots = self._params, self._roots
        return other

    def end(self) -> None:
        """Forget who the tester is."""
        self._pending, self.role = None, ""

    def challenge(self, certificate: bytes, challenge: bytes, wall_ns: int) -> bytes:
        """Take a tester's certificate and challenge; returns ours.

        Args:
            certificate: X.509, DER.
            challenge: of the tester; may be empty.
            wall_ns: now, for the certificate's validity.

        Raises:
            NegativeError: the certificate is not good, and why.
        """
        self._pending = None
        key, role = self._verified(certificate, datetime.fromtimestamp(wall_ns / 1e9, UTC))
        ours = self._random(CHALLENGE)
        self._pending = key, role, ours + challenge
        return ours

    def prove(self, proof: bytes) -> None:
        """Take the signature over our challenge and the tester's, in this order.

        Raises:
            NegativeError: none was asked for, or it is not the certificate's.
        """
        pending, self._pending = self._pending, None
        if pending is None:
            raise NegativeError(Nrc.REQUEST_SEQUENCE_ERROR)
        key, role, signed = pending
        refuse_unless(_is_signed(key, proof, signed), Nrc.OWNERSHIP_NOT_PROVEN)
        self.role = role

    def _verified(self, data: bytes, now: datetime) -> tuple[Any, str]:
        """Return public key and role of a certificate that is good."""
        from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load

        assert self._params is not None
        try:
            certificate = x509.load_der_x509_certificate(data)
            units = certificate.subject.get_attributes_for_oid(x509.NameOID.ORGANIZATIONAL_UNIT_NAME)
            usage = _extension(certificate, x509.KeyUsage)
            limits = _extension(certificate, x509.BasicConstraints)
            key = certificate.public_key()
        except (ValueError, x509.UnsupportedGeneralNameType, x509.DuplicateExtension) as error:
            raise NegativeError(Nrc.CERTIFICATE_FORMAT) from error
        self._check_issuer(certificate)
        good = certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc
        refuse_unless(good, Nrc.CERTIFICATE_TIME)
        is_tester = not (limits is not None and limits.ca) and (usage is None or usage.digital_signature)
        refuse_unless(is_tester and _is_known(key), Nrc.CERTIFICATE_TYPE)
        refuse_unless(certificate.serial_number not in self._params.revoked, Nrc.CERTIFICATE_REVOKED)
        role = next((str(unit.value) for unit in units if unit.value in self._params.roles), "")
        refuse_unless(bool(role), Nrc.CERTIFICATE_SCOPE)
        return key, role

    def _check_issuer(self, certificate: Any) -> None:
        """Refuse a certificate that no root has signed; one between them is not taken."""
        from cryptography.exceptions import InvalidSignature  # noqa: PLC0415 - an extra, and slow to load

        named = False
        for root in self._roots:
            try:
                certificate.verify_directly_issued_by(root)
            except InvalidSignature:
                named = True
            except (ValueError, TypeError):
                continue
            else:
                return
        raise NegativeError(Nrc.CERTIFICATE_SIGNATURE if named else Nrc.CERTIFICATE_CHAIN)


def _extension(certificate: Any, kind: Any) -> Any:
    from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load

    try:
        return certificate.extensions.get_extension_for_class(kind).value
    except x509.ExtensionNotFound:
        return None


def _is_known(key: Any) -> bool:
    from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa  # noqa: PLC0415 - an extra, slow to load

    strong = not isinstance(key, rsa.RSAPublicKey) or key.key_size >= 2048
    return strong and isinstance(key, ed25519.Ed25519PublicKey | ec.EllipticCurvePublicKey | rsa.RSAPublicKey)


def _is_signed(key: Any, signature: bytes, data: bytes) -> bool:
    """Tell whether a signature is the key's."""
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


def _roots(params: AuthenticationParams) -> list[Any]:
    """Read the roots.

    Raises:
        InputError: one cannot be read, or cryptography is not installed.
    """
    need("auth", "certificates", key="output.uds.authentication")
    from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load

    found = []
    for k, path in enumerate(params.roots):
        key = f"output.uds.authentication.roots[{k}]"
        try:
            found.append(x509.load_pem_x509_certificate(path.read_bytes()))
        except OSError as error:
            raise InputError(error.strerror or str(error), key=key, value=str(path)) from error
        except ValueError as error:
            raise InputError("this is no certificate in PEM", key=key, value=str(path)) from error
    return found
