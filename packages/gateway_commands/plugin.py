"""Plug-in of the commands on files and fault memories."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    commands={
        **{
            name: f"gateway_commands.commands:{name}"
            for name in ("record", "check", "schema", "example", "warmup", "doctor")
        },
        "new-monitor": "gateway_commands.commands:new_monitor",
        "faults": "gateway_commands.commands:faults_app",
        "convert log": "gateway_commands.commands:convert_log",
    }
)
