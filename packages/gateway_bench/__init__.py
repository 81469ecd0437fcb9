"""The bench: virtual ECUs, scenarios, and the plug-in of pytest."""
