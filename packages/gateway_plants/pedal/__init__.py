"""The redundant brake pedal: monitor, mathematics, virtual ECU."""
