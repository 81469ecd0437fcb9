"""Frames through a configured gateway, by the functions that ``gateway replay`` is made of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway.bus.frames import Frames
from gateway.config.model import Config
from gateway.runtime.app import Gateway
from gateway_replay.replay import replay


@dataclass
class Said:
    """Results of a gateway: (seconds, fault, failed) of each DTC that was set or passed; its monitors' readouts."""

    dtcs: list[tuple[float, str, bool]] = field(default_factory=list)
    monitors: dict[str, Any] = field(default_factory=dict)

    @property
    def set(self) -> list[str]:
        """Faults that were set, in their order, each once."""
        return list(dict.fromkeys(name for _, name, failed in self.dtcs if failed))

    def at(self, name: str) -> float | None:
        """When a fault was set first [s]; None: never."""
        return next((t for t, fault, failed in self.dtcs if failed and fault == name), None)


def config_of(monitor: dict[str, Any], database: Path | str, **more: Any) -> Config:
    """A configuration of one bus and one monitor, from the tables that a file would have."""
    bus = {"name": "can0", "uri": "loopback:127.0.0.1:29999", "database": [str(database)]}
    return Config.model_validate({"name": "t", "bus": [bus], "monitor": [{"name": "m", **monitor}], **more})


def through(config: Config, batches: Iterable[Frames]) -> Said:
    """Replay frames, in memory.

    Args:
        config: of the gateway.
        batches: of frames, in order of time.
    """
    said = Said()
    gateway = Gateway(config, None)

    def listen(event: dict[str, Any]) -> None:
        if event["event"] == "dtc":
            said.dtcs.append((event["t_ns"] * 1e-9, event["fault"].partition(".")[2], bool(event["status"] & 1)))

    gateway.listen(listen)
    try:
        replay(gateway, batches)
        said.monitors = gateway.summary(1.0)["monitors"]
    finally:
        gateway.close()
    return said
