"""Linear plants: monitor, mathematics, virtual ECU."""
