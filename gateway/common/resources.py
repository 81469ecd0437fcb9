"""Files that come with the gateway: databases, scenarios, configurations."""

from __future__ import annotations

from pathlib import Path

from gateway.errors import InputError

_PACKAGE = Path(__file__).parent.parent


def shipped(name: str) -> Path:
    """Return the path of a shipped file, e.g. ``dbc/gateway.dbc``.

    They lie beside the package in a checkout, and in ``gateway/shipped`` of an installed wheel.

    Raises:
        InputError: there is no such file.
    """
    for root in (_PACKAGE / "shipped", _PACKAGE.parent):
        path = root / name
        if path.exists():
            return path
    raise InputError("no such file comes with the gateway", value=name)
