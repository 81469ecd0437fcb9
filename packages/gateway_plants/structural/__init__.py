"""Plants given as a model of equations: monitor, mathematics, virtual ECU."""
