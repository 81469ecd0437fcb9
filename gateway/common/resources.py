"""Files that come with the gateway: databases, scenarios, configurations."""

from __future__ import annotations

import re
from pathlib import Path

from gateway.common.log import get_logger
from gateway.errors import InputError

_PACKAGE = Path(__file__).parent.parent

#: Files that were called otherwise before version 0.2: one name for one plant since then.
_RENAMED = (
    (r"(scenarios|configs|dbc|bench)/hybrid(_|\.)", r"\1/truck\2"),
    (r"(scenarios|configs)/(aircraft|belt)", r"\1/linear_\2"),
    (r"(configs|dbc)/comma_pedal\.", r"\1/pedal_comma."),
    (r"dbc/plant\.", "dbc/linear."),
    (r"dbc/engine\.", "dbc/crank."),
    (r"models/hybrid_truck\.", "models/truck."),
)

_log = get_logger(__name__)


def renamed(name: str) -> str | None:
    """Return what a shipped file is called now, None if it never had another name."""
    for old, new in _RENAMED:
        now = re.sub(f"^{old}", new, name)
        if now != name:
            return now
    return None


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
    now = renamed(name)
    if now is not None:
        found = shipped(now)
        _log.warning("renamed", file=name, now=now)
        return found
    raise InputError("no such file comes with the gateway", value=name)
