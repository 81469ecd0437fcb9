"""Monitored systems, one file each, all of one shape (see :mod:`gateway.monitors.contract`)."""
