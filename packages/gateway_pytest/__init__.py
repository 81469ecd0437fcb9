"""The door of the pytest plugin: pytest opens it in every project in whose environment the gateway is installed.

It imports nothing of the gateway, and does nothing, unless the project asks: by ``gateway_scenarios`` or
``gateway_config`` in its pytest settings, or by ``gateway_conformance`` among pytest's arguments. It stands beside the
package, not in it: to import that is not nothing.
"""

from __future__ import annotations

import re

import pytest

#: The suite as an argument: the package, a module or a path of it.
_SUITE = re.compile(r"^(?:[^-].*/)?gateway_conformance(?:$|[/.:])")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the settings, and an option that does nothing without them."""
    parser.addini("gateway_scenarios", "folders whose scenarios (.toml) are tests", type="paths", default=[])
    parser.addini("gateway_config", "configuration of the fixture gateway_bench", type="paths", default=[])
    parser.addini("gateway_artifacts", "folder of what failed tests leave", type="paths", default=[])
    group = parser.getgroup("gateway", "ECU gateway")
    group.addoption(
        "--gateway-bus",
        action="append",
        default=[],
        metavar="[NAME=]URI",
        help="Real buses in real time, as socketcan:vcan0; {worker} in it becomes the worker's name (xdist).",
    )
    group.addoption("--gateway-seed", type=int, metavar="N", help="Seed of all scenarios and virtual ECUs.")


def pytest_load_initial_conftests(early_config: pytest.Config, parser: pytest.Parser, args: list[str]) -> None:
    """Bring in the conformance suite where it is what runs: no other project has its options, as ``--target``."""
    if any(_SUITE.search(argument) for argument in args):
        from gateway_conformance import plugin  # noqa: PLC0415 - only where it is asked for

        plugin.add_options(parser)
        early_config.pluginmanager.register(plugin, "gateway_conformance.plugin")


def pytest_configure(config: pytest.Config) -> None:
    """Bring in the plugin itself where it is asked for."""
    if config.getini("gateway_scenarios") or config.getini("gateway_config"):
        from gateway_bench.pytest_plugin import plugin  # noqa: PLC0415 - only where it is asked for

        config.pluginmanager.register(plugin, "gateway_bench.pytest_plugin.plugin")
