"""Fault memory: status byte, occurrence, freeze frames, and the store that outlives the process."""
