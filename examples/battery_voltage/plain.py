"""Battery voltage: too low, or too high, at a terminal that a message carries. Plain Python; see docs/monitors.md."""

from gateway.monitors.contract import Debounce
from gateway.monitors.plain import Result, monitor


@monitor(
    signals=["BATT.Voltage [V]"],
    fault={"low": "P0562-16", "high": "P0563-17"},
    debounce=Debounce(failed_after=5, passed_after=5),
    tested="voltage [V]",
)
def battery_voltage(volts: float, low: float = 11.0, high: float = 15.5, hysteresis: float = 0.5) -> dict[str, Result]:
    """Battery voltage outside its limits."""
    found = {}
    if not low <= volts < low + hysteresis:  # within the hysteresis nothing is judged, and the debounce holds
        found["low"] = Result(volts < low, volts, low)
    if not high - hysteresis < volts <= high:
        found["high"] = Result(volts > high, volts, high)
    return found
