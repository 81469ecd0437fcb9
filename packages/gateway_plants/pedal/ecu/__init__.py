"""Virtual ECU of a brake pedal with two or three sensors."""

from gateway_plants.pedal.ecu.ecu import ECU

__all__ = ["ECU"]
