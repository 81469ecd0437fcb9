"""Slow states: by how much a plant's parameters and its sensors are off, followed while tests run."""
