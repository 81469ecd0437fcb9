"""The hooks; registered by ``gateway_pytest`` where a project asks for it."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import pytest

from gateway.common.trust import runs_already
from gateway_bench.pytest_plugin.attachments import attach
from gateway_bench.pytest_plugin.can_log import CanLog
from gateway_bench.pytest_plugin.fixtures import buses_of, can_log, check_monitor, dtcs, gateway_bench, uds, virtual_ecu
from gateway_bench.pytest_plugin.scenarios import ScenarioFile, is_scenario
from gateway_fdi.errors import GatewayError

__all__ = ["can_log", "check_monitor", "dtcs", "gateway_bench", "uds", "virtual_ecu"]


def _folders(config: pytest.Config) -> list[Path]:
    return [folder.resolve() for folder in config.getini("gateway_scenarios")]


def pytest_configure(config: pytest.Config) -> None:
    """Name the markers; without files on the command line the folders of scenarios are looked through, too.

    Raises:
        UsageError: a folder that is not there; several workers on one bus.
    """
    config.addinivalue_line("markers", "requirement(id, ...): requirements that a test is for; JUnit properties")
    config.addinivalue_line("markers", "gateway(config=...): configuration of its bench, relative to the test's file")
    buses_of(config)
    runs_already(config.rootpath)  # by pytest: its tests are code of this folder
    for folder in _folders(config):
        if not folder.is_dir():
            raise pytest.UsageError(f"gateway_scenarios: no such folder: {folder}")
        if config.args_source is not pytest.Config.ArgsSource.ARGS and not _covered(folder, config):
            config.args.append(str(folder))


def _covered(folder: Path, config: pytest.Config) -> bool:
    """Return whether a folder is looked through anyway."""
    given = [(config.invocation_params.dir / argument.partition("::")[0]).resolve() for argument in config.args]
    return any(folder.is_relative_to(other) for other in given)


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Take the scenarios below the folders of the setting."""
    if file_path.suffix != ".toml" or not any(file_path.resolve().is_relative_to(f) for f in _folders(parent.config)):
        return None
    collector: pytest.Collector | None = None
    if is_scenario(file_path):
        collector = ScenarioFile.from_parent(parent, path=file_path)
    return collector


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Note the requirements that a test is for, where reports have its properties."""
    for marker in item.iter_markers("requirement"):
        item.user_properties += [("requirement", str(name)) for name in marker.args]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Tell a mistake in one line with its place in the test; leave the frames of a failed test as a file."""
    report = yield
    if report.failed and call.excinfo is not None and isinstance(call.excinfo.value, GatewayError):
        report.longrepr = _mistake(item, call.excinfo)
    log = getattr(item, "funcargs", {}).get("can_log")
    if report.when == "call" and report.failed and isinstance(log, CanLog):
        try:
            file = log.write()
            report.sections.append(("CAN log", str(file)))
            item.user_properties.append(("recording", str(file)))
        except (GatewayError, OSError) as error:
            report.sections.append(("CAN log", f"could not be written: {error}"))
    return report


@pytest.hookimpl(wrapper=True)
def pytest_sessionfinish(session: pytest.Session) -> Generator[None, None, None]:
    """Name the files that failed tests have left where continuous integration looks for them in the JUnit file."""
    yield
    path = session.config.getoption("xmlpath", None)
    if path and not hasattr(session.config, "workerinput"):
        attach(Path(path))


def _mistake(item: pytest.Item, found: pytest.ExceptionInfo[BaseException]) -> str:
    """Return the text of a mistake: the way through the gateway's code does not help its author."""
    mine = [entry for entry in found.traceback if Path(entry.path) == item.path]
    if not mine:
        return str(found.value)
    return f"{item.path}:{mine[-1].lineno + 1}: {str(mine[-1].statement).strip()}\nE   {found.value}"
