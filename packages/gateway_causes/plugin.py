"""Plug-in of the diagnosis of causes."""

from gateway.plugin import Plugin

PLUGIN = Plugin(calls={"diagnosis": "gateway_causes.explainer:Explainer"})
