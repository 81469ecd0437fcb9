"""The analysis of a model of equations: ``gateway structure``."""
