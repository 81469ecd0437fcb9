"""What filters bring to the gateway."""

from gateway.plugin import Plugin

PLUGIN = Plugin(monitors={"filter": "gateway_plants.filter.monitor:FAMILY"})
