"""How kernels are run, as the environment says.

``NUMBA_DISABLE_JIT=1``: as plain Python, for a debugger. ``GATEWAY_BOUNDSCHECK=1``: compiled with every index checked.
``GATEWAY_CACHE_DIR`` (else ``NUMBA_CACHE_DIR``, else the user's cache directory): where compiled kernels are kept.
``GATEWAY_KERNELS=shipped``: nothing may be compiled; a kernel that would have to be is an error (tests).
``GATEWAY_KERNELS=source``: shipped code is not used. ``GATEWAY_KERNELS=changed``: it is used where its key fits.
With both, bitcode is kept beside what is compiled (``scripts/precompile``).
"""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

from gateway_fdi.common import progress


def _on(name: str) -> bool:
    return os.environ.get(name, "") not in ("", "0")


#: Whether the loader of machine code is there. Without it kernels run as plain Python: right, but hundreds of times
#: slower.
LOADABLE: bool = importlib.util.find_spec("llvmlite") is not None

if not LOADABLE:
    progress.say(
        "llvmlite is missing: kernels run as plain Python, right but hundreds of times slower, too slow for a bus"
        " (pip install llvmlite)"
    )

#: True when kernels are compiled; False under ``NUMBA_DISABLE_JIT=1``, or where llvmlite is missing.
COMPILED: bool = LOADABLE and not _on("NUMBA_DISABLE_JIT")

#: Whether each index of each kernel is checked against its array's length; else only of entries that ask for it.
BOUNDSCHECK: bool = _on("GATEWAY_BOUNDSCHECK")

#: Whether code is made to be shipped; whether what is shipped is used, and whether what is not may be compiled.
BUILDING: bool = os.environ.get("GATEWAY_KERNELS") in ("source", "changed")
USE_SHIPPED: bool = os.environ.get("GATEWAY_KERNELS") != "source" and not BOUNDSCHECK
MAY_COMPILE: bool = os.environ.get("GATEWAY_KERNELS") != "shipped"


def cache_directory() -> Path:
    """Return where compiled kernels are kept."""
    base = os.environ.get("GATEWAY_CACHE_DIR") or os.environ.get("NUMBA_CACHE_DIR")
    if base:
        return Path(base) / "kernels"
    import platformdirs  # noqa: PLC0415 - most starts are told by what is shipped

    return Path(platformdirs.user_cache_dir("ecu-gateway")) / "kernels"
