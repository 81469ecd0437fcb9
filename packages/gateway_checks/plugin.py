"""Plug-in of the checks: monitors that know no plant."""

from gateway.plugin import Plugin

PLUGIN = Plugin(monitors={name: f"gateway_checks.{name}:MONITOR" for name in ("signal", "rule", "sender_clock")})
