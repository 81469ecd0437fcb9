"""Virtual ECU of an active front steering."""

from gateway.vecu.steering.ecu import ECU

__all__ = ["ECU"]
