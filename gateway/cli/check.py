"""``gateway check``: is a configuration right?"""

from __future__ import annotations

from pathlib import Path

from gateway.app import Gateway
from gateway.cli.present import find_config, print_json, say_if_cold
from gateway.config import load_config, monitor_of, schema
from gateway.errors import InputError, InputErrors
from gateway.monitors.registry import MONITORS


def check(config_path: Path | None, *, schema_wanted: bool, json: bool) -> int:
    """Check a configuration; returns the exit code."""
    if schema_wanted:
        print_json(schema(), indent=2)
        return 0
    path = find_config(config_path)
    try:
        config = load_config(path)
        say_if_cold()
        gateway = Gateway(config, None, file=path)
    except (InputError, InputErrors) as error:
        if not json:
            raise
        errors = error.errors if isinstance(error, InputErrors) else [error]
        print_json(
            {
                "ok": False,
                "errors": [
                    {"file": e.file, "line": e.line, "key": e.key, "message": e.message}
                    for e in errors
                ],
            }
        )
        return 2
    faults = [
        {"fault": d.id, "dtc": str(d.dtc), "description": d.description} for d in gateway.catalogue
    ]
    gateway.close()
    warnings = [
        f"{entry.name}: {text}"
        for entry in config.monitor
        if (of := MONITORS[entry.type].warnings) is not None
        for text in of(monitor_of(entry)[1])
    ]
    if json:
        print_json({"ok": True, "faults": faults, "warnings": warnings})
    else:
        print(f"{path}: good. {len(config.bus)} bus(es), {len(config.monitor)} monitor(s), faults:")
        for fault in faults:
            print(f"  {fault['dtc']}  {fault['fault']}: {fault['description']}")
        for text in warnings:
            print(f"warning: {text}")
    return 0
