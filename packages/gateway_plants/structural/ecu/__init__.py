"""Virtual ECU of a plant that is told by its equations: a structural model simulated, and its signals sent."""

from gateway_plants.structural.ecu.ecu import ECU

__all__ = ["ECU"]
