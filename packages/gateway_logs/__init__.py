"""Logs of other tools: their formats, collections of them, tables of signals."""
