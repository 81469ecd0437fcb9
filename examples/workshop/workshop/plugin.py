"""All that this package brings to the gateway; nothing here is imported before it is used."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    commands={"workshop": "workshop.command:workshop"},
    readers={".bench": "workshop.reader:BenchLog"},
    protections={"workshop": "workshop.rule:checksum"},
    keys={"workshop": "workshop.key:key"},
    servers={"workshop": "workshop.server:SERVER"},
)
