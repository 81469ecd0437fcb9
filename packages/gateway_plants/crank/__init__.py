"""The crankshaft wheel: monitor, mathematics, virtual ECU."""
