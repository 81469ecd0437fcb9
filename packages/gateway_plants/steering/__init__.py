"""The angle of a steering motor: monitor, mathematics, virtual ECU."""
