"""Virtual ECUs: plants, the frames real ECUs would send, injected faults, scenarios."""
