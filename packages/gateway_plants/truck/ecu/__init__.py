"""Virtual ECU of a hybrid truck on a driving cycle."""

from gateway_plants.truck.ecu.ecu import ECU

__all__ = ["ECU"]
