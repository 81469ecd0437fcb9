"""``gateway bus``: a CAN bus between processes."""

from __future__ import annotations

from gateway.bus.uri import loopback_address
from gateway.cli.present import print_json, say
from gateway.cli.run import Ending
from gateway_bench.hub import Hub


def bus(address: str, *, duration: float | None, json: bool = False) -> int:
    """Serve until told to stop; returns the exit code."""
    host, port = loopback_address(address)
    ending = Ending().after(duration)
    hub = Hub(host, port)
    try:
        host, port = hub.address
        uri = f"loopback:{host}:{port}"
        say(f"bus: serving {uri} (socketcand protocol)")
        if json:
            print_json({"event": "bus", "uri": uri, "state": "open"})
        hub.serve_forever(ending)
    finally:
        hub.close()
    facts = "  ".join(f"{name} {count}" for name, count in vars(hub.statistics).items())
    say(f"bus: {facts}")
    if json:
        print_json({"event": "summary", "uri": uri, **vars(hub.statistics)})
    return 0
