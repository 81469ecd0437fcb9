"""Buses as they are shown: state, load, errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gateway.bus.traffic import load_of


class BusLoads:
    """Makes shares of time of counted bits.

    Args:
        buses: as the status socket's hello has them.
    """

    def __init__(self, buses: Sequence[Mapping[str, Any]]) -> None:
        self._described = {bus["name"]: bus for bus in buses}
        self._before: dict[str, tuple[int, Mapping[str, int]]] = {}

    def shown(self, message: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return each bus with its load and its frames a second since the message before."""
        now = int(message["t_ns"])
        return [self._bus(dict(bus), now) for bus in message["buses"]]

    def _bus(self, bus: dict[str, Any], now: int) -> dict[str, Any]:
        described = self._described.get(bus["bus"], {})
        traffic = bus.pop("traffic")
        before = self._before.get(bus["bus"])
        self._before[bus["bus"]] = now, traffic
        bus["load"] = bus["frames_per_s"] = bus["kbit_per_s"] = None
        if before is not None and now > before[0]:
            seconds = (now - before[0]) / 1e9
            new = {name: traffic[name] - before[1][name] for name in traffic}
            bits = (new["nominal_bits"], new["data_bits"])
            bus["load"] = load_of(bits, (described.get("bitrate"), described.get("data_bitrate")), seconds)
            bus["frames_per_s"] = new["frames"] / seconds
            bus["kbit_per_s"] = sum(bits) / seconds / 1e3
        bus["bitrate"], bus["filtered"] = described.get("bitrate"), described.get("filtered", False)
        bus["frames"] = traffic["frames"]
        return bus
