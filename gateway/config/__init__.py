"""The configuration: its keys, its file, and the objects that its names stand for."""
