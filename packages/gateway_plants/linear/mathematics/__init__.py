"""Linear plants with additive faults, and observers of them."""
