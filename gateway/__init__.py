"""CAN-bus ECU diagnostic gateway: model-based fault detection with a real fault memory."""

__version__ = "0.1.0"

from gateway.quick_start import import_can

import_can()  # before anything here, or cantools, imports can
