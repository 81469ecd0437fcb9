"""The configuration: its keys, its file, and what its names stand for."""
