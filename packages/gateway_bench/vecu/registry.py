"""The types of virtual ECU that a scenario can name; one that no scenario names is not imported.

They come by plug-ins, by entry points of the group ``gateway.vecu``, or as ``"package.module:NAME"``; a NAME may be a
class with ``step(t, inputs)``, too.
"""

from __future__ import annotations

from typing import Any

from gateway.common.plugins import Registry
from gateway_bench.vecu.contract import VirtualEcu, accepted
from gateway_bench.vecu.python_model import ecu_of, is_model

#: Types that were called otherwise before version 0.2.
RENAMED = {"engine": "crank", "hybrid_truck": "truck"}


def _accepted(found: object, name: str) -> VirtualEcu[Any, Any]:
    """Return what a name stands for: a virtual ECU, or the one that a class with ``step`` is.

    Raises:
        InputError: it is neither, or of another version.
    """
    if is_model(found):
        assert isinstance(found, type)
        return ecu_of(found)
    return accepted(found, name)


VIRTUAL_ECUS: Registry[VirtualEcu[Any, Any]] = Registry("gateway.vecu", _accepted)
