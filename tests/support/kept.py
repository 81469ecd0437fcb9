"""Texts that stay as they are kept: what differs is seen line by line, and is meant or not."""

import json
import os


def kept(file, data):
    """Return the bytes of a file that is kept; GATEWAY_KEEP=1 writes it, where a change is meant."""
    if os.environ.get("GATEWAY_KEEP"):
        file.write_bytes(data)
    return file.read_bytes()


def keys_of(schema):
    """Yield a line for each key of a JSON Schema: where it stands, and all that is asked of it but words."""
    for name, model in {"": schema, **schema.get("$defs", {})}.items():
        for kind in (model, *(one for one in model.get("anyOf", ()) if "properties" in one)):
            type_ = {} if kind is model else kind["properties"].get("type", {})
            place = f"{name}.{type_['const']}" if "const" in type_ else name
            for key, one in kind.get("properties", {}).items():
                yield f"{place}.{key} {json.dumps(_asked(one), sort_keys=True)}"
            yield f"{place} {json.dumps(sorted(kind.get('required', ())))}"


def _asked(one):
    if isinstance(one, dict):
        return {key: _asked(value) for key, value in one.items() if key not in ("description", "title")}
    return [_asked(value) for value in one] if isinstance(one, list) else one
