"""What this plant brings to the gateway."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    monitors={"structural": "gateway_plants.structural.monitor:FAMILY"},
    ecus={"structural": "gateway_plants.structural.ecu:ECU"},
    commands={
        "structure": "gateway_plants.structural.cli:structure",
        "evaluate structural": "gateway_plants.structural.cli:evaluate_structural",
    },
)
