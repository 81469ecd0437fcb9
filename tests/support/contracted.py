"""Whether events are those of the contract: by its JSON Schema, as a stranger reads it, and by its own look."""

import json

import jsonschema_rs

from gateway.common.jsonlines import line
from gateway.runtime.contract import EVENTS, schema, wrong

_WHOLE = schema()
#: Of each kind: nothing else is allowed, so that a new field is not forgotten in the table.
_STRICT = {
    name: jsonschema_rs.validator_for({**_WHOLE["$defs"][name], "additionalProperties": False}) for name in EVENTS
}


def why_not(event):
    """Return why an event is not in the contract, "" if it is."""
    told = json.loads(line(event))
    validator = _STRICT.get(told["event"])
    if validator is None:
        return "its kind is not there"
    ours = wrong(told)
    found = next(iter(validator.iter_errors(told)), None)
    return ours or ("" if found is None else f"{found.message} at {list(found.instance_path)}")
