"""The fixtures; each test has a bench of its own."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import pytest

from gateway.monitors.conformance import accepted, checked_emission, connections
from gateway_bench.pytest_plugin.bench import Bench
from gateway_bench.pytest_plugin.can_log import CanLog
from gateway_bench.pytest_plugin.dtcs import Dtcs
from gateway_bench.pytest_plugin.uds import client_of
from gateway_commands.self_test import try_out
from gateway_fdi.common.tomlfile import validate
from gateway_fdi.errors import GatewayError

if TYPE_CHECKING:
    from udsoncan.client import Client

    from gateway.monitors.contract import Monitor

#: Longest name of a folder that is made of a test's name.
_MOST_OF_NAME = 100


def _config_of(request: pytest.FixtureRequest) -> Path:
    """Return the configuration that a test asks for: by the marker ``gateway``, else by the setting."""
    marker = request.node.get_closest_marker("gateway")
    if marker is not None and "config" in marker.kwargs:
        return Path(request.path).parent / str(marker.kwargs["config"])
    files: list[Path] = request.config.getini("gateway_config")
    if not files:
        pytest.fail("which configuration? Set gateway_config, or @pytest.mark.gateway(config=...)", pytrace=False)
    return files[0]


def buses_of(config: pytest.Config) -> list[str]:
    """Return the buses that the command line asks for; none: tests stay in this process.

    Raises:
        UsageError: several workers on one bus.
    """
    given: list[str] = config.getoption("--gateway-bus")
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    several = bool(worker) or bool(config.getoption("numprocesses", None))
    if given and several and not all("{worker}" in uri for uri in given):
        text = "--gateway-bus: workers of xdist cannot share a bus: put {worker} into it, or leave out -n"
        raise pytest.UsageError(text)
    return [uri.replace("{worker}", worker or "main") for uri in given]


@pytest.fixture
def gateway_bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """A gateway with a clock that the test moves: ``run``, ``run_until``, ``send``, ``set``, ``events``."""
    seed = request.config.getoption("--gateway-seed")
    try:
        bench = Bench(_config_of(request), 1 if seed is None else seed, buses_of(request.config))
    except GatewayError as error:
        pytest.fail(str(error), pytrace=False)
    request.node.user_properties.append(("seed", 1 if seed is None else seed))
    yield bench
    bench.close()


@pytest.fixture
def virtual_ecu(gateway_bench: Bench) -> Callable[..., str]:
    """Switches on a virtual ECU: ``virtual_ecu("restbus", nodes=["A"], faults=[...], duration_s=60)``."""

    def switch_on(type_: str, **keys: Any) -> str:
        return gateway_bench.add(type_, **keys)

    return switch_on


@pytest.fixture
def dtcs(gateway_bench: Bench) -> Dtcs:
    """``dtcs.expect("P0336-29", by=4.5, healed_by=9.0)``, ``absent``, ``none``, ``failed``, ``seen``."""
    return Dtcs(gateway_bench)


def left_in(folder: Path, nodeid: str) -> Path:
    """Return the folder below a folder in which a test leaves its files, one of its own for each test.

    Args:
        folder: of the setting ``gateway_artifacts``.
        nodeid: of the test, as pytest has it: ``tests/test_a.py::TestB::test_c[4]``.
    """
    file, *names = nodeid.split("::")
    return folder.joinpath(*map(_folder_name, (*PurePosixPath(file).with_suffix("").parts, *names)))


def _folder_name(part: str) -> str:
    """Return part of a test's name as the name of a folder; two that differ stay two."""
    name = re.sub(r"[^\w.,=+\[\]-]", "_", part)[:_MOST_OF_NAME]
    if name == part and part not in (".", ".."):
        return name
    return f"{name}-{hashlib.blake2b(part.encode(), digest_size=4).hexdigest()}"


@pytest.fixture
def check_monitor(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Tries a monitor, every index checked: ``check_monitor(MONITOR)``, ``check_monitor(MONITOR, low=10.5)``.

    Its inputs are ordinary, missing (NaN), random and extreme. A mistake that would switch it off while it runs, or
    make results of no fault, fails the test. Random inputs are those of ``--gateway-seed``.
    """
    seed = request.config.getoption("--gateway-seed")

    def tried(monitor: Monitor[Any], **params: Any) -> None:
        try:
            accepted(monitor, monitor.type)
            given = validate(params, monitor.params, None, "")
            connections(monitor, given)
            checked_emission(monitor, given)
            found = try_out(monitor, given, 1 if seed is None else seed)
        except GatewayError as error:
            pytest.fail(str(error), pytrace=False)
        if found:
            pytest.fail("\n".join(f"{monitor.file}: {text}" for text in found), pytrace=False)

    request.node.user_properties.append(("seed", 1 if seed is None else seed))
    return tried


@pytest.fixture
def can_log(request: pytest.FixtureRequest, gateway_bench: Bench) -> CanLog:
    """All frames from here on: ``frames``, ``of("Message")``, ``write(path)``; a failed test leaves it as a file."""
    folders: list[Path] = request.config.getini("gateway_artifacts")
    folder = left_in(folders[0], request.node.nodeid) if folders else request.getfixturevalue("tmp_path")
    return CanLog(gateway_bench, folder / "can.log")


@pytest.fixture
def uds(gateway_bench: Bench) -> Client:
    """A client of udsoncan for the gateway's UDS server."""
    try:
        return client_of(gateway_bench)
    except GatewayError as error:
        pytest.fail(str(error), pytrace=False)
