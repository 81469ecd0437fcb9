"""Fault detection and isolation: mathematics that knows no bus; a library of its own."""
