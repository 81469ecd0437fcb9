"""Estimators of a motor's angle and speed from its currents and voltages (paper 001)."""
