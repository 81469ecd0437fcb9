"""The hybrid truck: monitor, mathematics, virtual ECU."""
