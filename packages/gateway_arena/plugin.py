"""Plug-in of the arena: its command."""

from gateway.plugin import Plugin

PLUGIN = Plugin(commands={"evaluate arena": "gateway_arena.commands:evaluate_arena"})
