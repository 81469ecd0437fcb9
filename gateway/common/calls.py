"""Functions that packages above the core bring for commands and the Python interface: the plug-ins' door ``calls``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gateway.common.plugins import Registry, accept_callable
from gateway_fdi.errors import GatewayError

#: By name.
CALLS: Registry[Callable[..., Any]] = Registry("gateway.calls", accept_callable)


def call_of(name: str) -> Callable[..., Any]:
    """Return a function of a package above the core.

    Raises:
        GatewayError: no installed package brings it.
    """
    if name not in CALLS:
        raise GatewayError(f"no installed package brings {name}")
    return CALLS[name]
