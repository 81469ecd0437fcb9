"""What this plant brings to the gateway."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    monitors={
        "redundant_pair": "gateway_plants.pedal.monitor:PAIR",
        "redundant_triple": "gateway_plants.pedal.monitor:TRIPLE",
    },
    ecus={"pedal": "gateway_plants.pedal.ecu:ECU"},
    commands={"evaluate pedal": "gateway_plants.pedal.cli:evaluate_pedal"},
)
