"""Tracking the teeth of a trigger wheel by their pulse times, through missed and added pulses."""
