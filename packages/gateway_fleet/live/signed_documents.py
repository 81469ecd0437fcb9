"""Signed documents of a fleet's owner: a line of signature, then TOML. Ed25519, of the package cryptography.

::

    #signed campaign KEY SIGNATURE
    fleet = "vans"
    ...

The signature is over the kind and the TOML, so that a document of one kind is none of another. Roots sign which keys
sign campaigns; so these can be changed and revoked, and a root stays safe that is in no computer that is always on.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from pydantic import Field

from gateway.faults.fleet import NAME
from gateway_fdi.common.tomlfile import StrictModel, parse_toml, validate
from gateway_fdi.errors import InputError
from gateway_fleet.live.identity import write_private

KEYS, CAMPAIGN = "keys", "campaign"
#: Bytes of a document at most.
MOST_BYTES = 1 << 18
_HEAD = re.compile(rb"#signed (keys|campaign) ([A-Za-z0-9+/=]{44}) ([A-Za-z0-9+/=]{88})\n")
_KEY = r"^[A-Za-z0-9+/]{43}=$"

M = TypeVar("M", bound=StrictModel)


class Keyring(StrictModel):
    """Keys that sign, as a car believes it."""

    fleet: str = Field(pattern=NAME, description="the fleet")
    serial: int = Field(ge=1, lt=2**53, description="larger than that of the one before")
    root: tuple[str, ...] = Field(min_length=1, max_length=8, description="public keys that sign the next keyring")
    signer: tuple[str, ...] = Field(max_length=16, description="public keys that sign campaigns; others are revoked")


def new_private(path: Path) -> str:
    """Make a private key, readable by its user only; returns the public one.

    Raises:
        InputError: there is a file, or it cannot be written.
    """
    key = Ed25519PrivateKey.generate()
    write_private(path, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return public_of(key)


def private_of(path: Path) -> Ed25519PrivateKey:
    """Return a private key.

    Raises:
        InputError: it is none.
    """
    try:
        key = load_pem_private_key(path.read_bytes(), None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError("no private key: it is made by gateway fleet signer", file=path) from error
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError("a private key of another kind than Ed25519", file=path)
    return key


def public_of(key: Ed25519PrivateKey) -> str:
    """Return the public key of a private one, as documents name it."""
    return base64.b64encode(key.public_key().public_bytes_raw()).decode()


def sign(kind: str, text: str, key: Ed25519PrivateKey) -> bytes:
    """Return a document with its signature."""
    content = text.encode()
    signature = base64.b64encode(key.sign(_signed(kind, content))).decode()
    return f"#signed {kind} {public_of(key)} {signature}\n".encode() + content


def _signed(kind: str, content: bytes) -> bytes:
    return f"ecu-gateway fleet {kind} 1\n".encode() + content


def opened(document: bytes, kind: str, believed: tuple[str, ...], model: type[M]) -> M:
    """Return what a document says, if one of the believed keys has signed it.

    Raises:
        InputError, InputErrors: none has, or it is no such document.
    """
    if len(document) > MOST_BYTES:
        raise InputError(f"a document of more than {MOST_BYTES} bytes")
    head = _HEAD.match(document)
    if head is None or head[1].decode() != kind:
        raise InputError(f"no signed document of this kind: {kind}")
    public, content = head[2].decode(), document[head.end() :]
    if public not in believed:
        raise InputError("signed by a key that is not believed, or no more", key="signature", value=public)
    try:
        Ed25519PublicKey.from_public_bytes(base64.b64decode(public, validate=True)).verify(
            base64.b64decode(head[3], validate=True), _signed(kind, content)
        )
    except (InvalidSignature, ValueError, binascii.Error) as error:
        raise InputError("the signature is not that of this document", key="signature") from error
    return validate(_parsed(content), model, None)


def _parsed(content: bytes) -> dict[str, Any]:
    try:
        return dict(parse_toml(content.decode()))
    except UnicodeDecodeError as error:
        raise InputError("no text") from error


def content_of(document: bytes) -> str:
    """Return the TOML of a signed document, its signature not looked at."""
    head = _HEAD.match(document)
    return document[0 if head is None else head.end() :].decode("utf-8", "replace")


def next_keyring(document: bytes, now: Keyring) -> Keyring:
    """Return the keyring that comes after another one.

    Raises:
        InputError: none of its roots has signed it, it is of another fleet, or not newer.
    """
    found = opened(document, KEYS, now.root, Keyring)
    if found.fleet != now.fleet:
        raise InputError("keys of another fleet", key="fleet", value=found.fleet)
    if found.serial <= now.serial:
        raise InputError(f"not newer than keys {now.serial}", key="serial", value=found.serial)
    return found


def is_over(until: datetime, now: datetime) -> bool:
    """Return whether a time is over; one without a zone is none."""
    return until.tzinfo is None or until <= now


def to_toml(values: Mapping[str, Any]) -> str:
    """Return a document's TOML."""
    import tomlkit  # noqa: PLC0415 - slow to load

    return tomlkit.dumps({name: value for name, value in values.items() if value is not None})
