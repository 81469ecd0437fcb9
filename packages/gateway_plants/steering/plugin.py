"""What this plant brings to the gateway."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    monitors={"steering_angle": "gateway_plants.steering.monitor:MONITOR"},
    ecus={"steering": "gateway_plants.steering.ecu:ECU"},
    commands={"evaluate steering": "gateway_plants.steering.cli:evaluate_steering"},
)
