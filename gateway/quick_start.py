"""python-can without what it loads for one format of logs.

``import can`` loads asammdf if it is there, and by it pandas and SymPy: a second of every start. So it is hidden while
python-can is loaded, and :func:`load_mf4` makes up for it before an MF4 log is opened.
"""

from __future__ import annotations

import importlib
import sys

_HIDDEN = "asammdf"


def import_can() -> None:
    """Load python-can without asammdf; does nothing if either is loaded already. Imports of one process, not of two."""
    if "can" in sys.modules or _HIDDEN in sys.modules:
        return
    # None in sys.modules makes an import fail as if the module were not installed (Python's import reference, 5.3.1).
    sys.modules[_HIDDEN] = None  # type: ignore[assignment]
    try:
        importlib.import_module("can")
    finally:
        del sys.modules[_HIDDEN]


def load_mf4() -> None:
    """Load asammdf and python-can's reader and writer for MF4.

    Reloading gives the module's functions their names: what python-can has registered of it works from then on.
    """
    module = importlib.import_module("can.io.mf4")
    if vars(module).get(_HIDDEN) is None:
        importlib.reload(module)
