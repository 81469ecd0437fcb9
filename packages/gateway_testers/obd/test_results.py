"""Mode 06 on CAN (SAE J1979): results of the monitors' tests with their limits, as a scan tool reads them.

A monitor is one monitor of J1979: its number (OBDMID) is one of those that are left to the manufacturer, 0xE1 to
0xFF, in the order of the catalogue; each of its faults is a test of it (TID 0x80 upwards). Value and limit are the
residual and the threshold of the latest test result, with the finest of the standard scalings of signed raw values
that holds both. A limit that a value must not exceed is the maximum, one that it must not fall below the minimum; the
other one is the end of the range. Before the first result since the clear, or since the operation cycle began, all
three are 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from gateway.faults.catalogue import FaultDefinition
from gateway.servers.tester_control import LatestResult, TesterControl

#: Numbers of monitors and tests that are left to the manufacturer.
MONITORS, TESTS = range(0xE1, 0x100), range(0x80, 0xFF)
#: Scalings of signed raw values: UASID, value of one step; the finest first (SAE J1979, Appendix E).
SCALINGS = ((0x85, 0.0000305), (0x86, 0.000305), (0x84, 0.001), (0x83, 0.01), (0x82, 0.1), (0x81, 1.0))
_LOW, _HIGH = -0x8000, 0x7FFF


class MonitorTests:
    """The tests of the emission related faults."""

    def __init__(self, catalogue: Iterable[FaultDefinition], control: TesterControl) -> None:
        self._control = control
        owners: dict[str, list[str]] = {}
        for definition in catalogue:
            if definition.emission_related:
                owners.setdefault(definition.id.rpartition(".")[0], []).append(definition.id)
        self._monitors: dict[int, Sequence[tuple[int, str]]] = {
            number: tuple(zip(TESTS, faults, strict=False))
            for number, faults in zip(MONITORS, owners.values(), strict=False)
        }

    @property
    def numbers(self) -> list[int]:
        """Numbers of the monitors that there are."""
        return list(self._monitors)

    def of(self, monitor: int, *, with_monitor: bool = True) -> bytes:
        """Return the results of a monitor: number, test, scaling, value, minimum and maximum of each; empty: none.

        Args:
            monitor: its number.
            with_monitor: whether each result has the monitor's number (mode 06), or not (0x22 F6xx).
        """
        head = bytes([monitor]) if with_monitor else b""
        made = b""
        for test, fault in self._monitors.get(monitor, ()):
            made += head + bytes([test]) + encode(self._control.test_result(fault))
        return made


def encode(result: LatestResult | None) -> bytes:
    """Return scaling, value, minimum and maximum of a test result; None: there is none yet."""
    if result is None or not (math.isfinite(result.value) and math.isfinite(result.limit)):
        return bytes([SCALINGS[-1][0]]) + bytes(6)
    greatest = max(abs(result.value), abs(result.limit))
    number, step = next((s for s in SCALINGS if round(greatest / s[1]) <= _HIGH), SCALINGS[-1])
    value, limit = (min(max(round(x / step), _LOW), _HIGH) for x in (result.value, result.limit))
    upper = (result.value > result.limit) == result.failed
    low, high = (_LOW, limit) if upper else (limit, _HIGH)
    return bytes([number]) + b"".join(x.to_bytes(2, "big", signed=True) for x in (value, low, high))
