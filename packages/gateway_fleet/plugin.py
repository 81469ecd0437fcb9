"""Plug-in of many cars: commands."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    calls={"learn": "gateway_fleet.learn.car:learn"},
    commands={
        "learn": "gateway_fleet.commands:learn",
        "calibrate": "gateway_fleet.commands:calibrate",
        "evaluate senders": "gateway_fleet.commands:evaluate_senders",
        "evaluate drives": "gateway_fleet.commands:evaluate_drives",
        "evaluate road": "gateway_fleet.commands:evaluate_road",
        "evaluate learn": "gateway_fleet.commands:evaluate_learn",
        "evaluate cause": "gateway_fleet.commands:evaluate_cause",
        "fleet run": "gateway_fleet.commands:fleet_run",
        "fleet diff": "gateway_fleet.commands:fleet_diff",
    },
)
