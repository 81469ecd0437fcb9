"""A broker on the command line: its options, and what they mean."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gateway.common.extras import need
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from gateway_serve.broker import Broker


def address_of(text: str, default: int, key: str) -> tuple[str, int]:
    """Return host and port of "HOST" or "HOST:PORT".

    Raises:
        InputError: it is none.
    """
    host, _, port = text.partition(":")
    if not host or not ((port.isdigit() and 0 < int(port) < 65536) or not port):
        raise InputError("HOST or HOST:PORT", key=key, value=text)
    return host, int(port) if port else default


def broker_of(
    text: str,
    *,
    user: str = "",
    password_file: Path | None = None,
    tls: bool = False,
    ca: Path | None = None,
    certificate: Path | None = None,
    key: Path | None = None,
) -> Broker:
    """Return the broker of a command; arguments as commands have them.

    Raises:
        InputError: it is none, or its password cannot be read.
    """
    need("mqtt", "brokers")
    from gateway_serve.broker import Broker  # noqa: PLC0415 - of an extra

    tls = tls or certificate is not None
    host, port = address_of(text, 8883 if tls else 1883, "BROKER")
    try:
        password = "" if password_file is None else password_file.read_text(encoding="utf-8").strip()
    except OSError as error:
        raise InputError(error.strerror or str(error), file=password_file) from error
    return Broker(host=host, port=port, user=user, password=password, tls=tls, ca=ca, certificate=certificate, key=key)
