"""Description of a gateway for its readers: the first line of the status socket."""

from __future__ import annotations

from typing import Any

from gateway import __version__
from gateway.runtime.app import Gateway
from gateway.servers.uds.params import S3_MS

#: Version of the protocol.
PROTOCOL = 1


def described(gateway: Gateway) -> dict[str, Any]:
    """Return what there is to see."""
    config = gateway.config
    told = gateway.describe()
    owners = {monitor.name: monitor.type for monitor in config.monitor}
    file, senders = gateway.store.path, gateway.senders
    asked = set(gateway.asking.askable)
    uds = config.output.uds
    return {
        "protocol": PROTOCOL,
        "version": __version__,
        "name": config.name,
        "memory": None if file is None else str(file.resolve()),
        "faults": [
            {**fault, "bus": _bus_of(gateway, k), "monitor": fault["id"].rpartition(".")[0],
             "ecu": senders.get(fault["id"].rpartition(".")[0], ""),
             "type": owners.get(fault["id"].split(".")[0], "check")}
            for k, fault in enumerate(told["faults"])
        ],
        "buses": [
            {"name": bus.name, "uri": bus.uri, "bitrate": bus.bitrate, "data_bitrate": bus.data_bitrate,
             "database": [str(path.resolve()) for path in bus.database],
             "filtered": gateway.identifiers_on(k) is not None}
            for k, bus in enumerate(config.bus)
        ],
        "ecus": [
            {"name": ecu.name, "bus": ecu.bus or config.bus[0].name, "asked": ecu.name in asked,
             "dids": sorted({read.key[1] for read in ecu.read if read.key[0] == 0x22})}
            for ecu in config.ecu
        ],
        "identifiers": told["identifiers"],
        "levels": [] if uds is None else uds.levels,
        "s3_s": (S3_MS if uds is None else uds.s3_ms) / 1e3,
        "signals": list(gateway.signal_slots),
        "notes": list(gateway.notes),
    }  # fmt: skip


def _bus_of(gateway: Gateway, fault: int) -> str:
    bus = gateway.engine.faults[fault].bus
    buses = gateway.config.buses
    return buses[bus].name if bus < len(buses) else ""
