"""``gateway faults export``: the catalogue for testers and other programs."""

from __future__ import annotations

from pathlib import Path

from gateway.cli.present import find_config
from gateway.common.jsonlines import line
from gateway.config.load import load_config
from gateway.runtime.app import Gateway


def export(config_path: Path | None, *, out: Path | None) -> int:
    """Write the catalogue as JSON; returns the exit code."""
    path = find_config(config_path)
    gateway = Gateway(load_config(path), None, file=path)
    try:
        text = line(gateway.describe(), indent=2)
    finally:
        gateway.close()
    if out is None:
        print(text)
    else:
        out.write_text(text + "\n")
    return 0
