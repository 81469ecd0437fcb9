"""Plug-in of the arena: its command, and its methods as monitors."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    commands={
        "evaluate arena": "gateway_arena.commands:evaluate_arena",
        "fit": "gateway_arena.commands:fit",
    },
    ecus={"turbo": "gateway_arena.ecu:ECU"},
    monitors={"method": "gateway_arena.monitor.monitor:FAMILY"},
    calls={"new_monitor_from": "gateway_arena.monitor.folder:new_monitor_from"},
)
