"""Evaluation of the crankshaft monitor (paper 000)."""
