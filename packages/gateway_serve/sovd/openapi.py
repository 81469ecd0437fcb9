"""The OpenAPI document (3.1): made of the endpoints and their models."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pydantic.json_schema import models_json_schema

from gateway import __version__
from gateway_serve.sovd.components import BASE
from gateway_serve.sovd.errors import GenericError
from gateway_serve.sovd.model import Body, Model
from gateway_serve.sovd.table import JSON, Endpoint, models_of

_REF = "#/components/schemas/{model}"
_TEXT = {"schema": {"type": "string"}}


def document(
    endpoints: Iterable[Endpoint], below: str = "", examples: Mapping[str, Sequence[str]] | None = None
) -> dict[str, Any]:
    """Return the document.

    Args:
        endpoints: in order.
        below: path of an entity: only what is below it, "": all.
        examples: values of parameters in the path, by their names.
    """
    chosen = [each for each in endpoints if not below or _is_below(each.path, below)]
    models: list[type[Model]] = [*models_of(chosen), GenericError]
    queries = list(dict.fromkeys(each.query for each in chosen if each.query.model_fields))
    asked = {each for each in models if issubclass(each, Body)}.union(queries)
    modes = [(each, "validation" if each in asked else "serialization") for each in (*models, *queries)]
    names, schemas = models_json_schema(modes, ref_template=_REF)  # type: ignore[arg-type]
    refs = {model: ref for (model, _), ref in names.items()}
    definitions = schemas["$defs"]
    paths: dict[str, Any] = {}
    for each in chosen:
        paths.setdefault(each.path, {})[each.method.lower()] = _operation(each, refs, definitions, examples or {})
    for model in queries:  # they are told as parameters
        definitions.pop(refs[model]["$ref"].rpartition("/")[2])
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "SOVD of the gateway",
            "version": __version__,
            "description": "Faults of a gateway and its ECUs (ISO 17978-3).",
        },
        "servers": [{"url": BASE}],
        "paths": paths,
        "components": {
            "schemas": definitions,
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


def _is_below(path: str, entity: str) -> bool:
    """Return whether a template is of an entity: /components/gateway is of /components/{component_id}."""
    parts, wanted = path.split("/"), entity.split("/")
    return parts[: len(wanted)] == wanted or (len(parts) >= 3 and parts[1] == wanted[1] and parts[2].startswith("{"))


def _operation(
    one: Endpoint, refs: dict[Any, Any], definitions: dict[str, Any], examples: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    names = re.findall(r"\{(\w+)\}", one.path)
    parameters: list[dict[str, Any]] = []
    for name in names:
        schema: dict[str, Any] = {"type": "string", "minLength": 1}
        if examples.get(name):
            schema["examples"] = list(examples[name])
        parameters.append({"name": name, "in": "path", "required": True, "schema": schema})
    if one.query.model_fields:
        parameters += _parameters(definitions[refs[one.query]["$ref"].rpartition("/")[2]], definitions)
    good: dict[str, Any] = {"description": "Done."}
    if one.answer is not None:
        good["content"] = {JSON: {"schema": refs[one.answer]}}
    elif one.status != 204:
        good["content"] = {one.media: _TEXT}
    if one.status == 201:
        good["headers"] = {"Location": {"required": True, "schema": {"type": "string"}}}
        good["links"] = _links(one)
    wrong = {"description": "It fails.", "content": {JSON: {"schema": refs[GenericError]}}}
    told: dict[str, Any] = {
        "operationId": _name(one.method, one.path),
        "summary": one.summary,
        "tags": [one.path.split("/")[1]],
        "parameters": parameters,
        "responses": {str(one.status): good, "default": wrong},
        "security": [{"token": []}] if one.method != "GET" else [{}, {"token": []}],
    }
    if one.body is not None:
        told["requestBody"] = {"required": True, "content": {JSON: {"schema": refs[one.body]}}}
    return told


def _links(one: Endpoint) -> dict[str, Any]:
    """Return the operations on what a request has made."""
    key = "lock_id" if one.path.endswith("/locks") else "subscription_id"
    parameters = {"component_id": "$request.path.component_id", key: "$response.body#/id"}
    path = f"{one.path}/{{{key}}}"
    operations = {method: _name(method, path) for method in ("get", "delete")}
    return {name: {"operationId": name, "parameters": parameters} for name in operations.values()}


def _parameters(schema: dict[str, Any], definitions: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the parameters of a model; an object's keys are each one: ``status[confirmedDTC]=1``."""
    found = []
    for name, each in schema["properties"].items():
        told = {"name": name, "in": "query", "required": False, "schema": _plain(each)}
        objects = [kind for kind in each.get("anyOf", ()) if "$ref" in kind]
        if objects:
            known = definitions[objects[0]["$ref"].rpartition("/")[2]]
            keys = {key: _plain(value) for key, value in known["properties"].items()}
            told |= {"style": "deepObject", "explode": True, "schema": {**known, "properties": keys}}
        found.append(told)
    return found


def _plain(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a parameter: it is left out, and never null."""
    kinds = [kind for kind in schema.get("anyOf", ()) if kind.get("type") != "null"]
    return kinds[0] if kinds else schema


def _name(method: str, path: str) -> str:
    parts = [part for part in re.split(r"[/-]", path) if part]
    return "_".join([method.lower(), *(f"by_{part[1:-1]}" if part.startswith("{") else part for part in parts)])
