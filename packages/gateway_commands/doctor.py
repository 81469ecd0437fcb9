"""``gateway doctor``: the features of this machine, and how to get those that it lacks."""

from __future__ import annotations

import platform
import socket
import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any, Protocol, cast

from gateway import __version__
from gateway.cli.present import find_config, print_json
from gateway.cli.version import version as version_text
from gateway.common.extras import EXTRAS, PURPOSES, installed, missing
from gateway.common.plugins import Registry, foreign, unusable
from gateway.common.times import zone_of
from gateway.config.load import load_config
from gateway.faults.service import daemon_state
from gateway_commands.faults import restarts_in_words
from gateway_fdi.errors import InputError
from gateway_fdi.jit import COMPILED, cache, shipped

#: Parts that another package can bring -> their group of entry points, and the module and name of the registry.
_DOORS = {
    "monitor": ("gateway.monitors", "gateway.monitors.registry", "MONITORS"),
    "ecu": ("gateway.vecu", "gateway_bench.vecu.registry", "VIRTUAL_ECUS"),
    "command": ("gateway.commands", "gateway.cli.commands", "OTHERS"),
    "call": ("gateway.calls", "gateway.common.calls", "CALLS"),
    "reader": ("gateway.readers", "gateway.bus.logs", "READERS"),
    "format": ("gateway.formats", "gateway.bus.log_format", "OTHERS"),
    "protection": ("gateway.protections", "gateway.signals.protection.rules", "OTHERS"),
    "key": ("gateway.keys", "gateway.servers.uds.security", "KEYS"),
    "measure": ("gateway.measures", "gateway_commands.doctor", "MEASURES"),
    "server": ("gateway.servers", "gateway.servers.types", "SERVERS"),
    "observer": ("gateway.observers", "gateway_fleet.learn.observers", "OBSERVERS"),
}
#: Of these the words for people, where they are others.
_WORDS = {
    "monitor": "monitor type",
    "ecu": "ecu type",
    "reader": "log reader",
    "format": "log format",
    "key": "key function",
    "server": "server type",
}
_LIBRARIES = ("numpy", "numba", "cantools", "python-can", "pydantic")


class Measure(Protocol):
    """A measurement of ``--bench``; another package brings it.

    Attributes:
        seconds: how long it takes.
    """

    seconds: float

    def measure(self, folder: Path) -> dict[str, Any]:
        """Return what it measured, by name; the fault memory's folder is for what depends on the disk."""

    def show(self, found: dict[str, Any]) -> None:
        """Print what was measured."""


MEASURES: Registry[Measure] = Registry("gateway.measures", lambda found, name: cast("Measure", found))


def _extras() -> dict[str, str | None]:
    """Return the version of each extra's package; None where it is not installed."""
    return {extra: _version(package) if installed(extra) else None for extra, package in EXTRAS.items()}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # it is distributed under another name, or comes with Python
        names = packages_distributions().get(package)
        return version(names[0]) if names else platform.python_version()


def no_socketcan() -> str:
    """Return why there is no SocketCAN here, "" if there is."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (AttributeError, OSError) as error:
        return f"no SocketCAN in this kernel ({error}): use loopback: or virtual: buses"
    return ""


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


def _daemon(config: Path | None, memory: Path | None) -> dict[str, Any] | None:
    """Return how the gateway of a fault memory does, None: there is no such memory."""
    path = memory or load_config(find_config(config)).memory.path
    return daemon_state(path) if path.exists() else None


def _kernel_buffers() -> dict[str, int]:
    found = {}
    for name in ("rmem_default", "rmem_max"):
        try:
            found[name] = int(Path(f"/proc/sys/net/core/{name}").read_text())
        except (OSError, ValueError):
            continue
    return found


def _print_daemon(daemon: dict[str, Any] | None) -> None:
    if daemon is None:
        print("no gateway has run here yet (no fault memory)")
        return
    print(f"gateway of {daemon['memory']}: {'running' if daemon['running'] else 'not running'}")
    if not daemon["stored"]:
        print("  it cannot write its fault memory: free the disk, or see its log for the reason")
    if text := restarts_in_words(daemon["restarts"]):
        print(f"  {text}")
    for bus in daemon["buses"]:
        state = ", ".join(bus[key] for key in ("state", "activity") if key in bus)  # earlier versions did not tell
        print(f"  {bus['bus']} ({bus['uri']}): {state}, {bus['received']} received, {bus['sent']} sent")
        if bus["overflow"]:
            print(
                f"    {bus['overflow']} frames lost before they were read: give it a larger buffer"
                " (?rcvbuf=bytes in the URI, sysctl net.core.rmem_max), or less to do"
            )
        if bus["unsent"] or bus["refused"]:
            print(f"    {bus['unsent']} frames never sent, {bus['refused']} that the bus cannot carry")
        if bus.get("driver_errors"):
            print(f"    {bus['driver_errors']} exceptions of its driver, after which it was tried again")
        if bus["losses"]:
            print(f"    lost {bus['losses']} times {bus['reason']}".rstrip())


def _kernels() -> dict[str, Any]:
    """Return where the machine code of kernels comes from."""
    there, changed = shipped.survey()
    kept, size = cache.size()
    return {
        "compiled": COMPILED,
        "shipped": there,
        "changed": changed,
        "cache": str(cache.folder()),
        "cached": kept,
        "cached_bytes": size,
    }


def _kernel_line(kernels: dict[str, Any]) -> str:
    """Return one line about the kernels."""
    if not COMPILED:
        return (
            "kernels run as plain Python (NUMBA_DISABLE_JIT is set, or llvmlite is missing): hundreds of times slower"
        )
    text = f"kernels: {kernels['shipped']} shipped"
    if kernels["changed"]:
        text += f" ({kernels['changed']} with changed sources: compiled when needed)"
    return f"{text}, {kernels['cached']} compiled here ({kernels['cached_bytes'] / 1e6:.1f} MB in {kernels['cache']})"


def _plugins() -> dict[str, dict[str, str]]:
    """Return what other packages bring, by door, with what is wrong with it ("": nothing)."""
    found: dict[str, dict[str, str]] = {"plug-in": {name: error.message for name, error in unusable().items()}}
    for door, (group, module, registry_name) in _DOORS.items():
        found[door] = {}
        names = foreign(group)
        if names:  # else its registry is not imported
            registry = getattr(import_module(module), registry_name)
            for name, known in registry.described(names).items():
                found[door][name] = known.message if isinstance(known, InputError) else ""
    return found


def _measured(config: Path | None, memory: Path | None) -> dict[str, Any]:
    """Return what this machine does, the disk being that of the fault memory."""
    folder = (memory or load_config(find_config(config)).memory.path).parent
    found: dict[str, Any] = {}
    for one in MEASURES.values():
        print(f"measuring for {one.seconds:.0f} s ...", file=sys.stderr, flush=True)
        found |= one.measure(folder if folder.is_dir() else Path())
    return found


def doctor(
    config: Path | None = None,
    *,
    memory: Path | None = None,
    running: bool = False,
    bench: bool = False,
    zone: str | None = None,
    json: bool,
) -> int:
    """Report of this machine, or of a log, where another file than a configuration is named; returns the exit code.

    It is 1 with ``running``, unless a gateway runs, its buses are open, and its memory can be written.
    """
    if config is not None and config.suffix.lower() != ".toml" and config.exists():
        from gateway_commands.doctor_log import describe  # noqa: PLC0415 - readers of logs, for this alone

        return describe(config, zone_of(zone or "UTC"), json=json)
    daemon = _daemon(config, memory)
    healthy = (
        daemon is not None
        and daemon["running"]
        and daemon["stored"]
        and all(bus["state"] == "open" for bus in daemon["buses"])
    )
    code = 1 if running and not healthy else 0
    lacking = no_socketcan()
    can = not lacking
    kernels, plugins, extras = _kernels(), _plugins(), _extras()
    libraries = {name: version(name) for name in _LIBRARIES}
    facts = {
        "gateway": __version__,
        "python": platform.python_version(),
        "kernel": platform.release(),
        "socketcan": can,
        "interfaces": _interfaces(),
        "buffers": _kernel_buffers(),
        "kernels": kernels,
        "daemon": daemon,
        "libraries": libraries,
        "extras": extras,
        "plugins": plugins,
    }
    measured = _measured(config, memory) if bench else {}
    if bench:
        facts["bench"] = measured
    if json:
        print_json(facts)
        return code
    print(f"gateway {version_text()}, Python {facts['python']}, kernel {facts['kernel']}")
    print(lacking or "SocketCAN is there")
    if can:
        shown = ", ".join(_interfaces()) or "none; make one: ip link add dev vcan0 type vcan"
        print(f"CAN interfaces: {shown}")
    print(_kernel_line(kernels))
    _print_daemon(daemon)
    print(", ".join(f"{name} {found}" for name, found in libraries.items()))
    for kind, types in plugins.items():
        for name, wrong in types.items():
            print(f"{_WORDS.get(kind, kind)} {name} of another package: {wrong or 'usable'}")
    for extra, package in extras.items():
        if package is None:
            print(f"no {missing(extra)}: pip install '.[{extra}]' in the checkout, for {PURPOSES[extra]}")
    if bench:
        for one in MEASURES.values():
            one.show(measured)
    return code
