"""What this plant brings to the gateway."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    monitors={
        "pi_bank": "gateway_plants.linear.monitor.pi_bank:MONITOR",
        "linear_observer": "gateway_plants.linear.monitor.observer:MONITOR",
    },
    ecus={"linear": "gateway_plants.linear.ecu:ECU"},
    commands={"evaluate linear": "gateway_plants.linear.cli:evaluate_linear"},
)
