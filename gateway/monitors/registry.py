"""The types of monitor that a configuration can name; one that no configuration names is not imported."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import cast

from gateway.monitors.shape import Monitor

#: Type -> the module that has it, and its name there.
_PLACES = {
    "crank_sync": ("gateway.monitors.crank_sync", "MONITOR"),
    "redundant_pair": ("gateway.monitors.brake_pedal", "PAIR"),
    "redundant_triple": ("gateway.monitors.brake_pedal", "TRIPLE"),
    "steering_angle": ("gateway.monitors.steering_angle", "MONITOR"),
    "pi_bank": ("gateway.monitors.pi_bank", "MONITOR"),
    "linear_observer": ("gateway.monitors.linear_observer", "MONITOR"),
    "hybrid_powertrain": ("gateway.monitors.hybrid_powertrain", "MONITOR"),
}


class _Registry(Mapping[str, Monitor]):
    """The monitors by type. To list the types imports nothing; to ask for a monitor imports it."""

    def __getitem__(self, type_: str) -> Monitor:
        module, name = _PLACES[type_]
        return cast(Monitor, getattr(import_module(module), name))

    def __iter__(self) -> Iterator[str]:
        return iter(_PLACES)

    def __len__(self) -> int:
        return len(_PLACES)


MONITORS: Mapping[str, Monitor] = _Registry()
