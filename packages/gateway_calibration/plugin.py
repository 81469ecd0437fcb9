"""Plug-in of calibration: thresholds from healthy logs."""

from gateway.plugin import Plugin

PLUGIN = Plugin(calls={"calibrate": "gateway_calibration.thresholds:thresholds"})
