"""Virtual ECU of any linear plant."""

from gateway.vecu.linear.ecu import ECU

__all__ = ["ECU"]
