"""Plug-in of the replay."""

from gateway.plugin import Plugin

PLUGIN = Plugin(commands={"replay": "gateway_replay.commands:replay", "plot": "gateway_replay.commands:plot_command"})
