"""``gateway mqtt``: publish the data of a running gateway at a broker."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

from gateway.cli.present import find_config, say
from gateway.cli.serve import socket_of
from gateway.common.extras import need
from gateway.config.load import load_config
from gateway.host.process import call_at_end
from gateway_fdi.errors import InputError


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
    need("mqtt", "brokers")
    from gateway.serve.mqtt import BrokerSettings, publish  # noqa: PLC0415 - of an extra

    host, _, port = broker.partition(":")
    if not host or not ((port.isdigit() and 0 < int(port) < 65536) or not port):
        raise InputError("HOST or HOST:PORT", key="BROKER", value=broker)
    config = load_config(find_config(config_path))
    try:
        password = "" if password_file is None else password_file.read_text(encoding="utf-8").strip()
    except OSError as error:
        raise InputError(error.strerror or str(error), file=password_file) from error
    number = int(port) if port else (8883 if tls else 1883)
    settings = BrokerSettings(host, number, base, tuple(signals), rate, user, password, tls, ca)
    place = status or socket_of(config)

    async def work() -> None:
        stop = asyncio.Event()
        call_at_end(asyncio.get_running_loop(), stop.set)
        say(f"telling {broker} of {place}")
        await publish(place, settings, config.name, stop)

    asyncio.run(work())
    return 0
