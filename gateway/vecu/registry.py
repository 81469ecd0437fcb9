"""The types of virtual ECU that a scenario can name; one that no scenario names is not imported.

Ours are the folders here: ``gateway/vecu/NAME`` with an ``ECU`` is type NAME. Those of other packages are entry points
of the group ``gateway.vecu``, or ``"package.module:NAME"``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gateway.common.plugins import Registry
from gateway.vecu.contract import VirtualEcu, accepted

#: Types that were called otherwise before version 0.2.
RENAMED = {"engine": "crank", "hybrid_truck": "truck"}

VIRTUAL_ECUS: Registry[VirtualEcu[Any, Any]] = Registry(
    "gateway.vecu",
    accepted,
    own={
        file.parent.name: f"gateway.vecu.{file.parent.name}:ECU"
        for file in sorted(Path(__file__).parent.glob("*/__init__.py"))
    },
)
