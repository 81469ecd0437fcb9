"""Plug-in of logs."""

from gateway.plugin import Plugin

PLUGIN = Plugin(commands={"decode": "gateway_logs.commands:decode"})
