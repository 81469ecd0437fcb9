"""Identity of a car in its fleet: a pseudonym that only the fleet's owner can make of a VIN.

HMAC-SHA-256 of the VIN by a key that the owner keeps, and that is in no car: who has a car, or all tables, can neither
find the VIN of an id nor the id of a VIN, though there are few VINs. The owner writes the id into the car, and into its
certificate as the common name.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from pathlib import Path

from gateway_fdi.errors import InputError

#: Bytes of a key at least; digits of an id.
KEY_BYTES, DIGITS = 32, 24
_VIN = re.compile(r"[A-HJ-NPR-Z0-9]{17}")


def new_key(path: Path) -> None:
    """Make a key of an owner, readable by its user only.

    Raises:
        InputError: there is one, or it cannot be written.
    """
    write_private(path, secrets.token_hex(KEY_BYTES).encode() + b"\n")


def write_private(path: Path, content: bytes) -> None:
    """Write a new file that its user only can read.

    Raises:
        InputError: there is one, or it cannot be written.
    """
    try:
        file = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
        try:
            with os.fdopen(file, "wb") as stream:
                stream.write(content)
        except OSError:
            path.unlink()  # half a key is none
            raise
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error


def car_id(vin: str, key_file: Path) -> str:
    """Return the id of a car.

    Raises:
        InputError: it is no VIN (ISO 3779), or the key is none.
    """
    if not _VIN.fullmatch(vin.strip().upper()):
        raise InputError("17 letters and digits, without I, O and Q (ISO 3779)", key="VIN", value=vin)
    try:
        key = bytes.fromhex(key_file.read_text(encoding="ascii").strip())
    except (OSError, ValueError) as error:
        raise InputError("no key: it is made by gateway fleet key", file=key_file) from error
    if len(key) < KEY_BYTES:
        raise InputError(f"a key of at least {KEY_BYTES} bytes", file=key_file)
    return hmac.new(key, vin.strip().upper().encode(), hashlib.sha256).hexdigest()[:DIGITS]
