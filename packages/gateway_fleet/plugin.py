"""Plug-in of many cars: commands."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    calls={
        "learn": "gateway_fleet.learn.car:learn",
        "campaign_limits": "gateway_fleet.live.limits:with_limits",
    },
    commands={
        "learn": "gateway_fleet.commands:learn",
        "calibrate": "gateway_fleet.commands:calibrate",
        "evaluate senders": "gateway_fleet.commands:evaluate_senders",
        "evaluate drives": "gateway_fleet.commands:evaluate_drives",
        "evaluate road": "gateway_fleet.commands:evaluate_road",
        "evaluate learn": "gateway_fleet.commands:evaluate_learn",
        "evaluate cause": "gateway_fleet.commands:evaluate_cause",
        "fleet run": "gateway_fleet.commands:fleet_run",
        "fleet report": "gateway_fleet.commands:fleet_report",
        "fleet diff": "gateway_fleet.commands:fleet_diff",
        "fleet join": "gateway_fleet.road:fleet_join",
        "fleet collect": "gateway_fleet.road:fleet_collect",
        "fleet key": "gateway_fleet.road:fleet_key",
        "fleet id": "gateway_fleet.road:fleet_id",
        "fleet contract": "gateway_fleet.road:fleet_contract",
        "fleet ask": "gateway_fleet.road:fleet_ask",
        "fleet learn": "gateway_fleet.road:fleet_learn",
        "fleet page": "gateway_fleet.road:fleet_page",
        "fleet signer": "gateway_fleet.road:fleet_signer",
        "fleet sign": "gateway_fleet.road:fleet_sign",
        "fleet publish": "gateway_fleet.road:fleet_publish",
        "fleet next": "gateway_fleet.road:fleet_next",
        "fleet forget": "gateway_fleet.road:fleet_forget",
        "fleet leave": "gateway_fleet.road:fleet_leave",
    },
)
