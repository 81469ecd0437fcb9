"""Virtual ECU of any linear plant."""

from gateway_plants.linear.ecu.ecu import ECU

__all__ = ["ECU"]
