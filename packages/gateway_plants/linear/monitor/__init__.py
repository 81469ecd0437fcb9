"""Monitors of linear plants: one observer, and banks of PI observers."""
