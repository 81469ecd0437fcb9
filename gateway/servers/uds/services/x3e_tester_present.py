"""0x3E TesterPresent (ISO 14229-1, 9.7): keeps the session."""

from __future__ import annotations

from gateway.servers.uds.context import ANY_SESSION, Context, Service


def _handle(_c: Context, request: bytes) -> bytes:
    return bytes([request[1] & 0x7F])


SERVICE = Service(0x3E, "TesterPresent", _handle, lambda _: {0x00: ANY_SESSION}, shortest=2, longest=2)
