"""Plug-in of the page: what shows a running gateway, asks it, and publishes its data."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    commands={name: f"gateway_serve.commands:{name}" for name in ("serve", "watch", "request", "report", "mqtt")},
    calls={"run_report": "gateway_serve.cli.run_report:RunReport"},
)
