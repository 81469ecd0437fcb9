"""Old name of :mod:`gateway_api`."""

from gateway.common.renamed import renamed

__getattr__ = renamed("gateway.api", "gateway_api")
