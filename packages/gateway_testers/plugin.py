"""Plug-in for testers of other makes."""

from gateway.plugin import Plugin

PLUGIN = Plugin(calls={"pdx_of": "gateway_testers.odx.export:pdx_of"})
