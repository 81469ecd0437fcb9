"""The types of monitor that a configuration can name."""

from __future__ import annotations

from gateway.monitors import (
    brake_pedal,
    crank_sync,
    hybrid_powertrain,
    linear_observer,
    pi_bank,
    steering_angle,
)
from gateway.monitors.shape import Monitor

MONITORS: dict[str, Monitor] = {
    monitor.type: monitor
    for monitor in (
        crank_sync.MONITOR,
        brake_pedal.PAIR,
        brake_pedal.TRIPLE,
        steering_angle.MONITOR,
        pi_bank.MONITOR,
        linear_observer.MONITOR,
        hybrid_powertrain.MONITOR,
    )
}
