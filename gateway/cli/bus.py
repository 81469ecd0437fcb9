"""``gateway bus``: a CAN bus between processes."""

from __future__ import annotations

from gateway.bus.hub import Hub
from gateway.bus.uri import loopback_address
from gateway.cli.present import say
from gateway.cli.run import Ending


def bus(address: str, *, duration: float | None) -> int:
    """Serve until told to stop; returns the exit code."""
    host, port = loopback_address(address)
    ending = Ending().after(duration)
    hub = Hub(host, port)
    try:
        host, port = hub.address
        say(f"bus: serving loopback:{host}:{port} (socketcand protocol)")
        hub.serve_forever(ending)
    finally:
        hub.close()
    facts = "  ".join(f"{name} {count}" for name, count in vars(hub.statistics).items())
    say(f"bus: {facts}")
    return 0
