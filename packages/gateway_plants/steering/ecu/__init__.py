"""Virtual ECU of an active front steering."""

from gateway_plants.steering.ecu.ecu import ECU

__all__ = ["ECU"]
