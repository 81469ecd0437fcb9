"""Virtual engine ECU: tooth times of a crankshaft sensor, and of a cam."""

from gateway_plants.crank.ecu.ecu import ECU

__all__ = ["ECU"]
