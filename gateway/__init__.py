"""CAN-bus ECU diagnostic gateway: model-based fault detection with a real fault memory.

Its Python interface is :mod:`gateway_api`.
"""

__version__ = "0.2.0"
