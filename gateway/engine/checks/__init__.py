"""Checks that the engine itself makes, of messages, buses, clock and memory: parameters, records, steps."""
