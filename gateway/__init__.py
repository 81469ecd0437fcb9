"""CAN-bus ECU diagnostic gateway: model-based fault detection with a real fault memory."""

__version__ = "0.1.0"
