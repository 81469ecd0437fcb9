"""Virtual ECU of a brake pedal with two or three sensors."""

from gateway.vecu.pedal.ecu import ECU

__all__ = ["ECU"]
