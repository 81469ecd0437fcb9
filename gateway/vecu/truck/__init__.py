"""Virtual ECU of a hybrid truck on a driving cycle."""

from gateway.vecu.truck.ecu import ECU

__all__ = ["ECU"]
