"""Bank of proportional-integral observers: isolates faults of actuators and of sensors (paper 003)."""
