"""Where the installed package bokeh has its files for browsers; nothing of them is copied into this project."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path


def bokeh_folder() -> Path:
    """Return their folder."""
    found = find_spec("bokeh")
    assert found is not None
    assert found.submodule_search_locations is not None
    return Path(found.submodule_search_locations[0]) / "server" / "static" / "js"
