"""Virtual engine ECU: tooth times of a crankshaft sensor, and of a cam."""

from gateway.vecu.crank.ecu import ECU

__all__ = ["ECU"]
