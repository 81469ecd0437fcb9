"""A plant as a package: its monitor and its virtual ECU, by name."""

from gateway.plugin import Plugin

PLUGIN = Plugin(monitors={"motor_load": "motor_load:MONITOR"}, ecus={"motor": "motor_ecu:ECU"})
