"""Components, and the addresses of resources."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from gateway_serve.sovd.errors import SovdError

#: Where all resources are.
BASE = "/sovd/v1"
#: The component that is the gateway itself.
OWN = "gateway"


@dataclass(frozen=True)
class Component:
    """An entity that has faults.

    Attributes:
        id: in the path.
        name: as it is configured.
        bus: where it is; "": on none.
        ecu: its name for UDS; "": it is not asked.
        sends: whether messages that it sends are checked.
    """

    id: str
    name: str
    bus: str
    ecu: str
    sends: bool = False


def slug(name: str) -> str:
    """Return a name as a part of a path."""
    return re.sub(r"[^A-Za-z0-9_.~-]", "_", name) or "_"


def known(entities: dict[str, Any], key: str, what: str) -> Any:
    """Return an entity by its id.

    Raises:
        SovdError: there is none.
    """
    if key not in entities:
        raise SovdError(404, f"there is no such {what}")
    return entities[key]


def place(*parts: str) -> str:
    """Return the address of a resource."""
    return f"{BASE}/" + "/".join(quote(part, safe="") for part in parts)
