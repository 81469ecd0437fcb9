"""``gateway fleet signer``, ``sign``, ``publish``, ``next``, ``forget``, ``leave``: for a fleet's owner, or a car's."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from gateway.cli.present import find_config, say, socket_of
from gateway.common.extras import need
from gateway.config.load import load_config
from gateway_fdi.errors import GatewayError, InputError
from gateway_serve.cli.broker import broker_of

#: How long a broker is waited for [s].
BROKER_S = 20.0


def fleet_signer(path: Path) -> int:
    """Make a key that signs; returns the exit code."""
    need("car", "signatures")
    from gateway_fleet.live.signed_documents import new_private  # noqa: PLC0415 - of an extra

    print(new_private(path))
    say(f"{path}: the private key; the line above is the public one")
    return 0


def fleet_sign(file: Path, key: Path, out: Path) -> int:
    """Sign a campaign, or keys; returns the exit code."""
    need("car", "signatures")
    from gateway_fdi.common.tomlfile import load, read_toml  # noqa: PLC0415 - of an extra
    from gateway_fleet.live.campaign import Campaign  # noqa: PLC0415
    from gateway_fleet.live.signed_documents import CAMPAIGN, KEYS, Keyring, private_of, sign  # noqa: PLC0415

    kind = KEYS if "root" in read_toml(file) else CAMPAIGN
    load(file, Keyring if kind == KEYS else Campaign)
    _write(out, sign(kind, file.read_text(encoding="utf-8"), private_of(key)))
    say(f"{out}: signed {kind}")
    return 0


def _write(path: Path, content: bytes) -> None:
    try:
        path.write_bytes(content)
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error


def fleet_publish(file: Path, broker: str, **by: Any) -> int:
    """Publish a signed document to all cars, those that come later too; returns the exit code."""
    need("car", "signatures")
    from gateway_fdi.common.tomlfile import parse_toml  # noqa: PLC0415
    from gateway_fleet.live.signed_documents import content_of  # noqa: PLC0415
    from gateway_serve.broker import BrokerLink  # noqa: PLC0415 - of an extra

    document = file.read_bytes()
    tables = parse_toml(content_of(document), file)
    name = "keys" if "root" in tables else f"campaign/{tables.get('name')}"
    link = BrokerLink(broker_of(broker, tls=by["ca"] is not None, **by), "owner", [], lambda *_: None)
    link.begin()
    try:
        until_s = time.monotonic() + BROKER_S
        while not link.is_there and time.monotonic() < until_s:
            time.sleep(0.05)
        if not link.is_there:
            raise GatewayError(f"{broker}: the broker is not reached")
        sent = link.publish(f"fleet/{tables.get('fleet')}/{name}", document, retain=True)
        sent.wait_for_publish(BROKER_S)
        if not sent.is_published():
            raise GatewayError(f"{broker}: the broker does not take it")
    finally:
        link.end()
    say(f"{file}: published as fleet/{tables.get('fleet')}/{name}")
    return 0


def fleet_next(file: Path, folder: Path, key: Path, out: Path, *, least_hours: float) -> int:
    """Sign the next stage of a campaign, or its end; returns the exit code: 1, if it is not time."""
    need("fleet", "tables of a fleet")
    from gateway_fdi.common.tomlfile import parse_toml, validate  # noqa: PLC0415 - of an extra
    from gateway_fleet.live.answers import Answers  # noqa: PLC0415
    from gateway_fleet.live.campaign import Campaign, next_stage  # noqa: PLC0415
    from gateway_fleet.live.signed_documents import CAMPAIGN, content_of, private_of, sign, to_toml  # noqa: PLC0415

    campaign = validate(parse_toml(content_of(file.read_bytes()), file), Campaign, file)
    stage, why = next_stage(campaign, Answers(folder).by_limits(), least_hours)
    say(f"{campaign.name}: {why}")
    if stage is None:
        return 1
    _write(out, sign(CAMPAIGN, to_toml(stage.model_dump()), private_of(key)))
    return 0


def fleet_forget(folder: Path, car: str) -> int:
    """Delete all data of a car; returns the exit code."""
    need("fleet", "tables of a fleet")
    from gateway_fleet.live.forget import forget  # noqa: PLC0415 - of an extra

    gone = forget(folder, car)
    print(", ".join(f"{count} of {name}" for name, count in gone.items()), "went")
    return 0


def fleet_leave(config_path: Path | None) -> int:
    """Empty a car's queue; returns the exit code."""
    need("car", "cars of a fleet")
    from gateway_fleet.live.join import Car  # noqa: PLC0415 - of an extra

    path = find_config(config_path)
    config = load_config(path)
    if config.fleet is None:
        raise InputError("no table [fleet]", file=path, key="fleet")
    car = Car(config.fleet, config.memory.path, socket_of(config))

    async def work() -> int:
        reading = asyncio.create_task(car.link.run())
        with suppress(TimeoutError):
            async with asyncio.timeout(2.0):
                while not car.connected:
                    await asyncio.sleep(0.05)
        count = 0
        while rows := car.queue.read(1000)[0]:
            numbers = [row.number for row in rows]
            await car.take_away(numbers)
            car.queue.note(numbers)
            count += len(rows)
        reading.cancel()
        return count

    count = asyncio.run(work())
    file = config.memory.path.with_name(config.memory.path.name + ".campaign")
    file.unlink(missing_ok=True)
    if config.fleet.limits is not None:
        config.fleet.limits.unlink(missing_ok=True)
    say(f"{count} events went; take [fleet] out of {path}, too")
    return 0
