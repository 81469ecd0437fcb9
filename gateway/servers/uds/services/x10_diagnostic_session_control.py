"""0x10 DiagnosticSessionControl (ISO 14229-1, 9.2): default and extended session."""

from __future__ import annotations

from gateway.servers.uds.context import ANY_SESSION, Context, Service


def _handle(c: Context, request: bytes) -> bytes:
    session = request[1] & 0x7F
    c.check_conditions()
    c.enter(session)
    p2, p2_star = c.params.p2_ms, c.params.p2_star_ms // 10
    return bytes([session]) + p2.to_bytes(2, "big") + p2_star.to_bytes(2, "big")


SERVICE = Service(
    0x10,
    "DiagnosticSessionControl",
    _handle,
    lambda _: dict.fromkeys(sorted(ANY_SESSION), ANY_SESSION),
    shortest=2,
    longest=2,
    action="session",
    undoes=lambda request: request[1:2] in (b"\x01", b"\x81"),
)
