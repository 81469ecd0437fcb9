"""``--html``: a run as one file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gateway.cli.present import say
from gateway.runtime.app import Gateway


class RunReport:
    """Collects a run, and writes its report.

    Args:
        path: of the report.
        gateway: not started yet.
        config: the file of its configuration.
    """

    def __init__(self, path: Path, gateway: Gateway, config: Path) -> None:
        from gateway_serve.report.collect import Collector  # noqa: PLC0415 - few want it

        self._path, self._gateway, self._config = path, gateway, config
        self.collector = Collector(gateway)

    def write_log(self, log: Path, events: Sequence[Mapping[str, Any]], injections: Sequence[str]) -> None:
        """Write the report of a log."""
        from gateway_serve.report.page import file_hash  # noqa: PLC0415 - loads bokeh

        source = [("log", log.name), ("SHA-256", file_hash(log))]
        source += [("fault put in", text) for text in injections]
        self.write(log.name, source, events=events)

    def write(self, title: str, source: Sequence[tuple[str, str]], **more: Any) -> None:
        """Write the report: its title, the command that was run, and more of ``gateway_serve.report.page.Words``."""
        from gateway_serve.report.page import Words, write_report  # noqa: PLC0415 - loads bokeh

        write_report(self._path, self._gateway, self.collector, Words(title, source, self._config, **more))
        say(f"report: {self._path}")
