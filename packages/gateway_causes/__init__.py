"""Causes of the faults that are there: which components explain them, and what that makes of their entries."""
