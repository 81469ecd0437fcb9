"""``gateway mqtt``: publish the data of a running gateway at a broker."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

from gateway.cli.present import find_config, say, socket_of
from gateway.config.load import load_config
from gateway.host.process import call_at_end
from gateway_serve.cli.broker import broker_of


def mqtt(
    broker: str,
    config_path: Path | None,
    *,
    status: Path | None,
    base: str,
    signals: Sequence[str],
    rate: float,
    user: str,
    password_file: Path | None,
    tls: bool,
    ca: Path | None,
) -> int:
    """Tell a broker until a signal comes; returns the exit code. Arguments as the command has them."""
    found = broker_of(broker, user=user, password_file=password_file, tls=tls, ca=ca)
    from gateway_serve.mqtt import Published, publish  # noqa: PLC0415 - of an extra

    config = load_config(find_config(config_path))
    told = Published(base, tuple(signals), rate)
    place = status or socket_of(config)

    async def work() -> None:
        stop = asyncio.Event()
        call_at_end(asyncio.get_running_loop(), stop.set)
        say(f"telling {broker} of {place}")
        await publish(place, found, told, config.name, stop)

    asyncio.run(work())
    return 0
