"""Old name of :mod:`gateway_commands.doctor`."""

from gateway.common.renamed import renamed

__getattr__ = renamed("gateway.cli.doctor", "gateway_commands.doctor")
