"""What all plants bring to the gateway: a plant is a folder here with a ``plugin.py``."""

from importlib import import_module
from pathlib import Path

from gateway.plugin import Plugin

PLUGIN = Plugin.joined(
    import_module(f"gateway_plants.{file.parent.name}.plugin").PLUGIN
    for file in sorted(Path(__file__).parent.glob("*/plugin.py"))
)
