"""``gateway fleet join``, ``collect``, ``key``, ``id``, ``contract``: a fleet on the road."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gateway.cli.present import find_config, print_json, say, socket_of
from gateway.common.extras import need
from gateway.config.load import load_config
from gateway.host.process import call_at_end
from gateway_fdi.errors import InputError
from gateway_serve.cli.broker import address_of, broker_of
from gateway_serve.works import work_until


def fleet_join(
    to: str, config_path: Path | None, *, status: Path | None, ca: Path | None, keys: Path | None, **by: Any
) -> int:
    """Take part in a fleet until a signal comes; returns the exit code. Arguments as the command has them."""
    need("car", "cars of a fleet")
    from gateway_fleet.live.deliver import ByBroker, ByPost  # noqa: PLC0415 - of an extra
    from gateway_fleet.live.member import Member  # noqa: PLC0415

    path = find_config(config_path)
    config = load_config(path)
    if config.fleet is None:
        raise InputError("no table [fleet]: name and car at least", file=path, key="fleet")
    by_post = to.startswith(("http://", "https://"))
    of = broker_of("none" if by_post else to, tls=ca is not None, ca=ca, **by)
    if by_post and keys is not None:
        raise InputError("campaigns come by a broker", key="--keys", value=str(keys))
    member = Member(config, path, status or socket_of(config), keys)
    car = member.car

    async def work() -> None:
        stop = asyncio.Event()
        call_at_end(asyncio.get_running_loop(), stop.set)
        way = ByPost(to, car.params, of) if by_post else ByBroker(of, car.params, member.topics, member.offer)
        if isinstance(way, ByBroker):
            way.begin()
        say(f"car {car.params.car} of fleet {car.params.name}: {config.memory.path} to {to}")
        try:
            await work_until(stop, [car.link.run, car.delivery(way).run, member.run], "the car takes part no more")
        finally:
            if isinstance(way, ByBroker):
                way.end()

    asyncio.run(work())
    return 0


def fleet_collect(
    folder: Path,
    fleet: str,
    *,
    broker: str | None,
    http: str | None,
    every: float,
    json: bool,
    ca: Path | None,
    **by: Any,
) -> int:
    """Collect until a signal comes; returns the exit code. Arguments as the command has them."""
    need("fleet", "collectors")
    if broker is None and http is None:
        raise InputError("where events come from: --broker, --http, or both", key="--broker")
    from gateway_fleet.live.batch import topic  # noqa: PLC0415
    from gateway_fleet.live.collect import Came, Collector, arrived, sender  # noqa: PLC0415
    from gateway_fleet.live.door import Door  # noqa: PLC0415
    from gateway_serve.broker import BrokerLink  # noqa: PLC0415 - of an extra

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    collector = Collector(folder, fleet, every)
    ends: list[Callable[[], Any]] = [collector.close]
    try:
        if broker is not None:
            of = broker_of(broker, tls=ca is not None, ca=ca, **by)
            link: BrokerLink

            def take(name: str, payload: bytes) -> None:
                car = sender(name, fleet)

                def answer(digest: str) -> None:
                    if digest:
                        link.publish(topic(fleet, car, "arrived"), arrived(digest))

                if car:
                    collector.put(Came(car, payload, answer))

            link = BrokerLink(of, f"collector-{fleet}", [topic(fleet, "+", "events")], take, lasting=True)
            link.begin()
            ends.append(link.end)
        if http is not None:
            address = address_of(http, 8787, "--http")
            door = Door(address, fleet, collector.put, certificate=by["certificate"], key=by["key"], ca=ca)
            door.begin()
            ends.append(door.shutdown)
        say(f"collecting fleet {fleet} into {folder}, tables every {every:.0f} s")
        collector.run(stop.is_set)
        kept, total = collector.kept, collector.inbox.totals()
    finally:
        for end in reversed(ends):
            end()
    if json:
        print_json({"event": "collected", **vars(kept), "total": total})
    else:
        print(f"{kept.new} events, {kept.again} came again, {kept.refused} refused; in all {total['events']} events")
        print(f"of {total['cars']} cars, which had to drop {total['dropped']}. Tables: {folder}")
    return 0


def fleet_key(path: Path) -> int:
    """Make the key of a fleet's owner; returns the exit code."""
    from gateway_fleet.live.identity import new_key  # noqa: PLC0415 - of this command only

    new_key(path)
    say(f"{path}: the key of the fleet's owner; it belongs into no car")
    return 0


def fleet_id(vin: str, key: Path) -> int:
    """Print the id of a car; returns the exit code."""
    from gateway_fleet.live.identity import car_id  # noqa: PLC0415 - of this command only

    print(car_id(vin, key))
    return 0


def fleet_contract(*, asyncapi: bool) -> int:
    """Print the contract of events; returns the exit code."""
    from gateway.runtime.contract import schema  # noqa: PLC0415 - of this command only

    if asyncapi:
        from gateway_fleet.live.asyncapi import document  # noqa: PLC0415

        print_json(document())
    else:
        print_json(schema())
    return 0
