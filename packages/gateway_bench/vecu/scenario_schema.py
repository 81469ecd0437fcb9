"""The JSON Schema of a scenario, with the keys and faults of every virtual ECU that is installed."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from gateway_bench.vecu.message_faults import MessageFault
from gateway_bench.vecu.registry import VIRTUAL_ECUS
from gateway_bench.vecu.scenario import Scenario
from gateway_fdi.errors import InputError


def schema() -> dict[str, Any]:
    """Return the schema; an ECU of a type that is no package may have any keys, and faults of kinds of its own."""
    document = Scenario.model_json_schema()
    defs = document["$defs"]

    def added(model: type[BaseModel], name: str) -> dict[str, Any]:
        """Return the schema of a model, with the models that it names among those of the document."""
        found = model.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
        defs.update({f"{name}.{part}": one for part, one in found.pop("$defs", {}).items()})
        return found

    ecus: list[dict[str, Any]] = [{"properties": {"type": {"pattern": ":"}}, "required": ["type"]}]
    faults = [added(MessageFault, "message")]
    for name, ecu in sorted(VIRTUAL_ECUS.described().items()):
        if isinstance(ecu, InputError):
            continue
        keys = added(ecu.params, name)
        keys["properties"]["type"] = {"const": name}
        ecus.append(keys)
        if ecu.fault is not None:
            faults.append(added(ecu.fault, f"{name}.fault"))
    known = list[str]()
    for fault in faults:
        fault["required"] = [name for name in fault["required"] if name != "ecu"]  # where there is one, it is this one
        kind = fault["properties"]["kind"]
        known += kind.get("enum", [kind.get("const")])
    faults.append({"properties": {"kind": {"not": {"enum": known}}}, "required": ["kind"]})
    defs["EcuParams"], defs["EcuFault"] = {"anyOf": ecus}, {"anyOf": faults}
    return document
