"""``gateway check --why``: the inputs that a fault's test depends on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gateway.cli.lines import Lines
from gateway.cli.present import find_config, print_json
from gateway.config.load import load_config
from gateway.engine.depends.parts import Seen
from gateway.faults.catalogue import FaultDefinition
from gateway.runtime.assemble import prepare
from gateway_commands.check import as_dict
from gateway_fdi.errors import InputError, InputErrors, each_of, named

#: Columns of the name of a component; of how it is known.
_NAME, _WHY = 42, 28


def why(config_path: Path | None, fault: str, *, json: bool) -> int:
    """Print what a fault's test depends on; returns the exit code.

    Raises:
        InputError, InputErrors: the configuration is wrong, or has no such fault.
    """
    try:
        definition, depends = _found(find_config(config_path), fault)
    except (InputError, InputErrors) as error:
        if not json:
            raise
        print_json({"ok": False, "errors": [as_dict(each) for each in each_of(error)]})
        return 2
    if json:
        dtc, text = str(definition.dtc), definition.description
        print_json({"fault": fault, "dtc": dtc, "description": text, "depends": [_row(one) for one in depends]})
        return 0
    lines = Lines()
    lines.print(f"{fault}  {definition.dtc}", mark=fault, colour="bold")
    lines.print(f"  {definition.description}", hang=2)
    lines.print(f"  {'its failure blames':{_NAME}}{'because':{_WHY}}sees", style="dim")
    for one in depends:
        name, why_known = one.component.name, f"{_short(one.why):{_WHY}}{100 * one.power:.2g} %"
        if len(name) < _NAME:
            lines.print(f"  {name:{_NAME}}{why_known}", hang=_NAME + 2)
        else:
            lines.print(f"  {name}", hang=4)
            lines.print(f"  {'':{_NAME}}{why_known}", hang=_NAME + 2)
    lines.print("  sees: how often it fails if that alone is at fault; so much its pass clears", style="dim", hang=2)
    return 0


def _found(path: Path, fault: str) -> tuple[FaultDefinition, tuple[Seen, ...]]:
    parts = prepare(load_config(path), path)
    definition = parts.catalogue.get(fault)
    if definition is None:
        raise InputError(named("no monitor reports this fault; known:", fault, parts.depends), key="--why", value=fault)
    return definition, parts.depends[fault]


def _short(text: str) -> str:
    return text if len(text) < _WHY else f"{text[: _WHY - 4]}..."


def _row(one: Seen) -> dict[str, Any]:
    return {"component": one.component.name, "kind": one.component.kind, "power": round(one.power, 6), "why": one.why}
