"""Tests that the faults of a monitor are made of."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gateway.engine.depends.monitors import of_tests
from gateway.engine.depends.parts import Network, Seen
from gateway.engine.instances import MonitorInstance
from gateway.monitors.contract import Behind


@dataclass(frozen=True)
class Tests:
    """The tests of one monitor.

    Attributes:
        monitor: its place in the engine.
        faults: ids of the faults that are made of them.
        seen: test -> what it sees; its name is no fault's.
        levels: state record of the monitor -> of each test, as the contract has it.
        false_alarms: test -> probability that it fails though all is well, of those that say it.
    """

    monitor: int
    faults: tuple[str, ...]
    seen: Mapping[str, tuple[Seen, ...]]
    levels: Callable[[np.void], Sequence[float]]
    false_alarms: Mapping[str, float]


def behind(monitors: Sequence[MonitorInstance], network: Network) -> tuple[Tests, ...]:
    """Return the tests of the monitors that tell theirs.

    Raises:
        InputError: what a monitor's author says of them is wrong.
    """
    found = []
    for k, m in enumerate(monitors):
        seen, capability = of_tests(m, network), m.monitor.capability(Behind)
        if capability is None or not seen:
            continue
        own = {f"{m.name}/{m.part}/{name}": each for name, each in seen.items()}
        alarms = {f"{m.name}/{m.part}/{name}": share for name, share in capability.false_alarms.items()}
        faults = tuple(f"{m.name}.{fault.name}" for fault in m.monitor.faults(m.params))
        found.append(Tests(k, faults, own, _reader(capability, m, len(own)), alarms))
    return tuple(found)


def _reader(capability: Behind, m: MonitorInstance, count: int) -> Callable[[np.void], Sequence[float]]:
    def read(state: np.void) -> Sequence[float]:
        levels = [float(level) for level in capability.levels(m.params, state)][:count]
        return levels + [math.nan] * (count - len(levels))

    return read
