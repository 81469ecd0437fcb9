"""The pages of the site that are made of the code: all keys of a configuration, all commands; a hook of mkdocs."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from mkdocs.structure.files import File, Files

from gateway.cli import app
from gateway.config.schema import schema

DOCS = Path(__file__).parents[2] / "docs"
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def cell(text: object) -> str:
    """Return a text that a cell of a table can hold."""
    return " ".join(str(text).split()).replace("|", "\\|").replace("<", "&lt;")


def parts(field: dict[str, Any]) -> Iterator[str]:
    """Yield the names of the tables that a field may hold."""
    if "$ref" in field:
        yield field["$ref"].removeprefix("#/$defs/")
    inner = (*field.get("anyOf", ()), *field.get("prefixItems", ()))
    for each in (*inner, field.get("items"), field.get("additionalProperties")):
        if isinstance(each, dict):
            yield from parts(each)


def kind(field: dict[str, Any]) -> str:
    """Return the type of a field, as a reader knows it."""
    if "const" in field or "enum" in field:
        return ", ".join(map(repr, field.get("enum", [field.get("const")])))
    if "anyOf" in field:
        return " or ".join(dict.fromkeys(kind(each) for each in field["anyOf"] if each.get("type") != "null"))
    if field.get("type") == "array":
        return f"list of {kind(field.get('items', {}))}"
    return "table" if "$ref" in field else field.get("type", "any").replace("object", "table")


def table(name: str, found: dict[str, Any], all_: dict[str, Any], above: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the lines of a table and of those within it."""
    keys, needed = found.get("properties", {}), found.get("required", ())
    if name:
        yield f"\n## `{name}`\n\n{cell(found.get('description', ''))}\n"
    yield "| key | type | default | meaning |\n|---|---|---|---|"
    for key, field in keys.items():
        value = field.get("default")
        bare = value is None or value == [] or isinstance(value, dict)  # a table's keys have defaults of their own
        default = "needed" if key in needed else "" if bare else f"`{json.dumps(value)}`"
        yield f"| `{key}` | {cell(kind(field))} | {default} | {cell(field.get('description', ''))} |"
    for key, field in keys.items():
        for part in dict.fromkeys(parts(field)):
            if part not in above and part != "MonitorConfig":
                yield from table(f"{name}.{key}".lstrip("."), all_[part], all_, (*above, part))


def configuration() -> str:
    """Return the page of all keys."""
    document = schema()
    all_ = document["$defs"]
    lines = ["# All keys of a configuration\n", *table("", document, all_), "\n# Monitors"]
    for one in all_["MonitorConfig"]["anyOf"]:
        if name := one["properties"]["type"].get("const"):
            rest = {key: field for key, field in one["properties"].items() if key != "type"}
            lines += table(f'monitor, type = "{name}"', {**one, "properties": rest, "description": ""}, all_)
    return "\n".join(lines)


def commands(command: Any, name: str, above: typer.Context | None = None) -> Iterator[str]:
    """Yield the help of a command and of those below it."""
    context = typer.Context(command, info_name=name.rpartition(" ")[2], parent=above)
    yield f"\n## `{name}`\n\n```text\n{command.get_help(context)}\n```"
    for each in command.list_commands(context) if hasattr(command, "list_commands") else ():
        below = command.get_command(context, each)
        if not below.hidden:
            yield from commands(below, f"{name} {each}", context)


def on_files(files: Files, config: Any) -> Files:
    """Add the pages to those of docs."""
    told = "# All commands\n" + "\n".join(commands(typer.main.get_command(app), "gateway"))
    for path, content in (("configuration", configuration()), ("commands", told)):
        files.append(File.generated(config, f"reference/{path}.md", content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Have links to files of the checkout that are no part of the site be their words alone."""
    folder = (DOCS / page.file.src_uri).parent

    def inside(link: re.Match[str]) -> str:
        path = link[2]
        if re.match(r"[a-z]+:", path) or page.file.src_uri.startswith("reference/"):
            return link[0]
        return link[0] if (folder / path).resolve().is_relative_to(DOCS.resolve()) else link[1]

    return LINK.sub(inside, markdown)
