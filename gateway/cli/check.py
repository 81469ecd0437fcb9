"""``gateway check``: is a configuration right?"""

from __future__ import annotations

from pathlib import Path

from gateway.cli.doctor import no_socketcan
from gateway.cli.present import find_config, print_json
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.config.monitor_types import monitor_of
from gateway.config.schema import schema
from gateway.errors import InputError, InputErrors
from gateway.runtime.app import Gateway

#: Columns that are left for a name after the codes given out for it, of 80.
_MOST_OF_NAME = 65


def check(config_path: Path | None, *, schema_wanted: bool, json: bool) -> int:
    """Check a configuration; returns the exit code."""
    if schema_wanted:
        print_json(schema(), indent=2)
        return 0
    path = find_config(config_path)
    try:
        config = load_config(path)
        gateway = Gateway(config, None, file=path)
    except (InputError, InputErrors) as error:
        if not json:
            raise
        errors = error.errors if isinstance(error, InputErrors) else [error]
        print_json(
            {
                "ok": False,
                "errors": [
                    {
                        "file": e.file,
                        "line": e.line,
                        "key": e.key,
                        "value": None if e.value is None else str(e.value),
                        "message": e.message,
                    }
                    for e in errors
                ],
            }
        )
        return 2
    faults = [{"fault": d.id, "dtc": str(d.dtc), "description": d.description} for d in gateway.catalogue]
    notes, codes = list(gateway.notes), dict(sorted(gateway.codes.items()))
    gateway.close()
    warnings = [
        f"{entry.name}: {text}"
        for entry in config.monitor
        for monitor, params in [monitor_of(entry)]
        for text in monitor.warnings(params)
    ]
    facts = [
        f"{entry.name}: {text}"
        for entry in config.monitor
        for monitor, params in [monitor_of(entry)]
        for text in monitor.facts(params)
    ]
    warnings += _of_this_machine(config)
    if json:
        print_json({"ok": True, "faults": faults, "codes": codes, "taken": notes, "facts": facts, "warnings": warnings})
    else:
        print(f"{path}: good. {len(config.bus)} bus(es), {len(config.monitor)} monitor(s), faults:")
        for fault in faults:
            print(f"  {fault['dtc']}  {fault['fault']}: {fault['description']}")
        if codes:
            print("codes given out (of messages: missing, and wrong):")
        for name, given in codes.items():
            print(f"  {' '.join(given):<11}  {_shortened(name)}")
        for text in notes:
            print(f"taken: {text}")
        for text in facts:
            print(text)
        for text in warnings:
            print(f"warning: {text}")
    return 0


def _shortened(name: str) -> str:
    """Return a name that fits into a line of 80 columns, its middle left out where it does not."""
    kept = (_MOST_OF_NAME - 3) // 2
    return name if len(name) <= _MOST_OF_NAME else f"{name[:kept]}...{name[-kept:]}"


def _of_this_machine(config: Config) -> list[str]:
    """Return what would end or surprise a gateway here, though the configuration is right."""
    said = []
    lacking = no_socketcan()
    for k, bus in enumerate(config.bus):
        if lacking and bus.uri.startswith("socketcan:"):
            said.append(f"bus[{k}].uri = {bus.uri!r}: gateway run ends here: {lacking}")
    folders = [("memory.path", config.memory.path.parent)]
    if config.record is not None:
        folders.append(("record.folder", config.record.folder))
    said += [
        f"{key}: the folder {folder.resolve()} is not there; gateway run makes it"
        for key, folder in folders
        if not folder.exists()
    ]
    return said
