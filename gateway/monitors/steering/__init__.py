"""Active front steering: angle sensors, current sensors, inverter (paper 001)."""

from gateway.monitors.steering.monitor import MONITOR

__all__ = ["MONITOR"]
