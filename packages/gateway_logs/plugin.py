"""Plug-in of logs: the formats of other tools, tables of signals."""

from gateway.plugin import Plugin

_FORMATS = ("asc", "blf", "csv", "mf4", "parquet", "trc")

PLUGIN = Plugin(
    formats={f".{name}": f"gateway_logs.formats:{name.upper()}" for name in _FORMATS},
    commands={"decode": "gateway_logs.commands:decode"},
)
