"""What this plant brings to the gateway."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    monitors={"hybrid_powertrain": "gateway_plants.truck.monitor:MONITOR"},
    ecus={"truck": "gateway_plants.truck.ecu:ECU"},
    commands={"evaluate truck": "gateway_plants.truck.cli:evaluate_truck"},
)
