"""Residual generators of ``models/truck.toml``, as :mod:`gateway_plants.truck.residual_generators` writes them."""

from gateway_plants.truck import residual_generators

residual_generators.make()
