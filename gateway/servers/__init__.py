"""How faults leave the gateway."""
