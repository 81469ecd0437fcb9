"""``gateway doctor``: what this machine offers, and what to do about what it lacks."""

from __future__ import annotations

import platform
import socket
from importlib.metadata import version
from pathlib import Path

from gateway import __version__
from gateway.cli.present import print_json
from gateway.jit import CACHE, COMPILED, cache_is_warm

_LIBRARIES = ("numpy", "numba", "cantools", "python-can", "pydantic", "asammdf")


def _socketcan() -> tuple[bool, str]:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (AttributeError, OSError) as error:
        return False, f"no SocketCAN in this kernel ({error}): use loopback: or virtual: buses"
    return True, "SocketCAN is there"


def _interfaces() -> list[str]:
    # 280 is ARPHRD_CAN, also of vcan and vxcan.
    found = []
    for folder in sorted(Path("/sys/class/net").glob("*")):
        try:
            if (folder / "type").read_text().strip() == "280":
                found.append(f"{folder.name} ({(folder / 'operstate').read_text().strip()})")
        except OSError:
            continue
    return found


def doctor(*, json: bool) -> int:
    """Report; returns the exit code."""
    can, said = _socketcan()
    facts = {
        "gateway": __version__,
        "python": platform.python_version(),
        "kernel": platform.release(),
        "socketcan": can,
        "interfaces": _interfaces(),
        "kernels_compiled": COMPILED,
        "cache": str(CACHE),
        "cache_warm": cache_is_warm(),
        "libraries": {name: version(name) for name in _LIBRARIES},
    }
    if json:
        print_json(facts)
        return 0
    print(f"gateway {__version__}, Python {facts['python']}, kernel {facts['kernel']}")
    print(said)
    if can:
        shown = ", ".join(_interfaces()) or "none; make one: ip link add dev vcan0 type vcan"
        print(f"CAN interfaces: {shown}")
    if not COMPILED:
        print("kernels run as plain Python (NUMBA_DISABLE_JIT is set): some hundred times slower")
    elif cache_is_warm():
        print(f"kernels are compiled: {CACHE}")
    else:
        print("kernels are not compiled yet: run gateway warmup")
    print(", ".join(f"{name} {version(name)}" for name in _LIBRARIES))
    return 0
