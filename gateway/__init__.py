"""CAN-bus ECU diagnostic gateway: model-based fault detection with a real fault memory."""

__version__ = "0.2.0"

from gateway.common.postponed import postpone

postpone()  # before anything here imports cantools or can-isotp
