"""Mathematics of fault detection and isolation, with no CAN in it."""
