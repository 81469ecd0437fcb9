"""A car that nobody knows: which ECUs it has, what they are, and the layouts of their answers."""
