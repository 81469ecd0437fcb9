"""Certificates of testers (X.509, RFC 5280): from the one that a tester shows to a root that the configuration trusts.

A tester shows its certificate, and after it those between it and a root, each of which has signed the one before. Of a
path only what this use needs is taken: names, signatures, validity, basic constraints with path length, key usage,
extended key usage, serial numbers that are revoked. Any other extension that is critical is refused, as RFC 5280 (4.2)
wants it. The role of a tester is the organizational unit (OU) of its subject.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

from gateway.common.extras import need
from gateway.servers.uds.nrc import NegativeError, Nrc, refuse_unless
from gateway_fdi.errors import InputError

#: Certificates between a tester's and a root. Each costs a verification before the answer.
MOST_BETWEEN = 3
#: Hashes under signatures; older ones can be forged.
_HASHES = ("sha256", "sha384", "sha512")
#: A DER sequence: its tag, and the mark of a length in further bytes (their number is added).
_SEQUENCE, _LONG = 0x30, 0x80


class Certificates:
    """Roots, and the certificates they vouch for.

    Args:
        roots: files of certificates (PEM).
        roles: roles that there are.
        revoked: serial numbers of certificates that are not good any more.

    Raises:
        InputError: a root cannot be read, or may not sign; or cryptography is not installed.
    """

    def __init__(self, roots: Sequence[Path], roles: Collection[str], revoked: Collection[int]) -> None:
        self._roots = [_root(path, f"output.uds.authentication.roots[{k}]") for k, path in enumerate(roots)]
        self._roles, self._revoked = roles, revoked

    def verified(self, data: bytes, now: datetime) -> tuple[Any, str]:
        """Return public key and role of a tester whose certificate is good.

        Args:
            data: its certificate and those between it and a root, one after the other (X.509, DER).
            now: for their validity.

        Raises:
            NegativeError: they are not good, and why.
        """
        chain = [_parsed(each) for each in _split(data)]
        self._check_signatures(chain)
        for certificate in chain:
            good = certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc
            refuse_unless(good, Nrc.CERTIFICATE_TIME)
        tester, *between = chain
        for below, certificate in enumerate(between):
            refuse_unless(_may_sign(certificate, below, strict=True), Nrc.CERTIFICATE_CHAIN)
        refuse_unless(_is_a_testers(tester), Nrc.CERTIFICATE_TYPE)
        refuse_unless(all(_is_known_whole(each) for each in chain), Nrc.CERTIFICATE_CONTENT)
        revoked = any(each.serial_number in self._revoked for each in chain)
        refuse_unless(not revoked, Nrc.CERTIFICATE_REVOKED)
        return tester.public_key(), self._role(tester)

    def _check_signatures(self, chain: Sequence[Any]) -> None:
        """Refuse what is not a chain: each signed by the next one, the last one by a root."""
        for certificate, issuer in pairwise(chain):
            _check_issued(certificate, [issuer])
        roots = [root for root in self._roots if _may_sign(root, len(chain) - 1, strict=False)]
        _check_issued(chain[-1], roots)

    def _role(self, certificate: Any) -> str:
        from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load

        units = certificate.subject.get_attributes_for_oid(x509.NameOID.ORGANIZATIONAL_UNIT_NAME)
        role = next((str(unit.value) for unit in units if unit.value in self._roles), "")
        refuse_unless(bool(role), Nrc.CERTIFICATE_SCOPE)
        return role


def is_strong(key: Any) -> bool:
    """Return whether a public key is of a kind that is taken here, and long enough."""
    from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa  # noqa: PLC0415 - an extra, slow to load

    long = not isinstance(key, rsa.RSAPublicKey) or key.key_size >= 2048
    return long and isinstance(key, ed25519.Ed25519PublicKey | ec.EllipticCurvePublicKey | rsa.RSAPublicKey)


def _split(data: bytes) -> list[bytes]:
    """Return DER sequences that stand one after the other; whether each is whole is for its parser to say.

    Raises:
        NegativeError: it is not that, or there are too many.
    """
    found: list[bytes] = []
    while data:
        refuse_unless(len(found) <= MOST_BETWEEN, Nrc.CERTIFICATE_CHAIN)
        refuse_unless(len(data) >= 2 and data[0] == _SEQUENCE, Nrc.CERTIFICATE_FORMAT)
        more = data[1] & ~_LONG if data[1] & _LONG else 0
        length = int.from_bytes(data[2 : 2 + more], "big") if more else data[1]
        end = 2 + more + length
        found.append(data[:end])
        data = data[end:]
    refuse_unless(bool(found), Nrc.CERTIFICATE_FORMAT)
    return found


def _parsed(data: bytes) -> Any:
    """Return a certificate of which everything that is asked for later can be read."""
    from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load
    from cryptography.exceptions import UnsupportedAlgorithm  # noqa: PLC0415 - likewise

    try:
        certificate = x509.load_der_x509_certificate(data)
        _ = certificate.extensions, certificate.subject, certificate.issuer, certificate.public_key()
    except (
        ValueError,
        UnsupportedAlgorithm,
        x509.UnsupportedGeneralNameType,
        x509.DuplicateExtension,
        x509.InvalidVersion,
    ) as error:
        raise NegativeError(Nrc.CERTIFICATE_FORMAT) from error
    return certificate


def _check_issued(certificate: Any, issuers: Sequence[Any]) -> None:
    """Refuse a certificate that none of these has signed."""
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm  # noqa: PLC0415 - slow to load

    named = False
    for issuer in issuers:
        try:
            certificate.verify_directly_issued_by(issuer)
            used = certificate.signature_hash_algorithm
        except (InvalidSignature, UnsupportedAlgorithm):
            named = True
        except (ValueError, TypeError):  # of another name, or of a kind that its key cannot make
            continue
        else:
            refuse_unless(used is None or used.name in _HASHES, Nrc.CERTIFICATE_SIGNATURE)
            return
    raise NegativeError(Nrc.CERTIFICATE_SIGNATURE if named else Nrc.CERTIFICATE_CHAIN)


def _may_sign(certificate: Any, below: int, *, strict: bool) -> bool:
    """Return whether a certificate may sign others, given the number below it (RFC 5280, 6.1.4 k to n).

    Args:
        certificate: which one.
        below: certificates between it and the tester's own.
        strict: whether it has to say so itself. A root is trusted by the configuration: it must not say otherwise.
    """
    from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load

    constraints = _extension(certificate, x509.BasicConstraints)
    usage = _extension(certificate, x509.KeyUsage)
    if strict and (constraints is None or usage is None or not is_strong(certificate.public_key())):
        return False
    if usage is not None and not usage.key_cert_sign:
        return False
    if constraints is None:
        return True
    return bool(constraints.ca and (constraints.path_length is None or constraints.path_length >= below))


def _is_a_testers(certificate: Any) -> bool:
    """Return whether a certificate is one to sign challenges with, and not to sign others."""
    from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load
    from cryptography.x509.oid import ExtendedKeyUsageOID  # noqa: PLC0415 - likewise

    constraints = _extension(certificate, x509.BasicConstraints)
    usage = _extension(certificate, x509.KeyUsage)
    purposes = _extension(certificate, x509.ExtendedKeyUsage)
    wanted = (ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE)
    return (
        not (constraints is not None and constraints.ca)
        and (usage is None or usage.digital_signature)
        and (purposes is None or any(purpose in wanted for purpose in purposes))
        and is_strong(certificate.public_key())
    )


def _is_known_whole(certificate: Any) -> bool:
    """Return whether all critical extensions of a certificate are those that are looked at here."""
    from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load

    known = (x509.BasicConstraints.oid, x509.KeyUsage.oid, x509.ExtendedKeyUsage.oid)
    return all(not each.critical or each.oid in known for each in certificate.extensions)


def _extension(certificate: Any, kind: Any) -> Any:
    from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load

    try:
        return certificate.extensions.get_extension_for_class(kind).value
    except x509.ExtensionNotFound:
        return None


def _root(path: Path, key: str) -> Any:
    """Read a root.

    Raises:
        InputError: it cannot be read, or may not sign others; or cryptography is not installed.
    """
    need("auth", "certificates", key="output.uds.authentication")
    from cryptography import x509  # noqa: PLC0415 - an extra, and slow to load

    try:
        root = x509.load_pem_x509_certificate(path.read_bytes())
        may_sign = _may_sign(root, 0, strict=False)
    except OSError as error:
        raise InputError(error.strerror or str(error), key=key, value=str(path)) from error
    except (ValueError, x509.DuplicateExtension) as error:
        raise InputError("this is no certificate in PEM", key=key, value=str(path)) from error
    if not may_sign:
        raise InputError("this certificate says itself that it signs no others", key=key, value=str(path))
    return root
