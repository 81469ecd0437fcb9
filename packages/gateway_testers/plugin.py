"""Plug-in for testers beside those of UDS on CAN: OBD, J1939, DoIP, and files for testers of other makes."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    calls={"pdx_of": "gateway_testers.odx.export:pdx_of"},
    sections={name: f"gateway_testers.{name}.section:SECTION" for name in ("doip", "j1939", "obd")},
)
