"""What this plant brings to the gateway."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    monitors={"crank_sync": "gateway_plants.crank.monitor:MONITOR"},
    ecus={"crank": "gateway_plants.crank.ecu:ECU"},
    commands={
        "evaluate crank": "gateway_plants.crank.cli:evaluate_crank",
        "convert teeth": "gateway_plants.crank.cli:convert_teeth",
    },
    observers={"teeth": "gateway_plants.crank.tooth_log:Teeth"},
)
