"""Modules of other packages that are not loaded before they are used.

cantools imports its tester, and with it python-can; can-isotp imports python-can for the buses of its own. The gateway
does not use these, and python-can looks for every format of logs: with asammdf installed it takes a second of each
start. So their names are bound as usual, and the module of a name is executed when its first attribute is asked for, by
:class:`importlib.util.LazyLoader`. Nothing is hidden and nothing made up for: it is the real module at any time. The
command line does so in its own process (:func:`gateway.cli.main`); a host that imports the gateway is left alone.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from importlib.util import LazyLoader
from types import ModuleType

#: cantools.tester derives a class from one of python-can's: that alone would load it.
NAMES = frozenset({"can", "cantools.logreader", "cantools.tester"})


class _Finder:
    """Finds what the other finders find, with a loader that waits."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name not in NAMES:
            return None
        for finder in sys.meta_path:
            if isinstance(finder, _Finder):
                continue
            spec = finder.find_spec(name, path, target)
            if spec is not None:
                if spec.loader is not None and not isinstance(spec.loader, LazyLoader):
                    spec.loader = LazyLoader(spec.loader)
                return spec
        return None


def postpone() -> None:
    """Let the modules of :data:`NAMES` wait for their use; those that are loaded already stay as they are."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())


def dask_setup(_worker: object) -> None:
    """Do so in a worker of Dask that preloads this module."""
    postpone()
