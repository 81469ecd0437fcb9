"""The pages of the site that are made of the code: keys, parameters of monitors, commands, Python; a hook of mkdocs."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from mkdocs.structure.files import File, Files

from gateway.cli import app
from gateway_commands.configuration_schema import schema

DOCS = Path(__file__).parents[2] / "docs"
#: The modules whose names are public (docs/api.md).
MODULES = ("gateway_api", "gateway_fdi", *(f"gateway_plants.{plant}.arrays" for plant in ("crank", "pedal", "linear")))
#: The unit in a key's description, and a docstring's name of what it refers to.
UNIT, ROLE = re.compile(r" ?\[([^][]+)\](?=$|[;,])"), re.compile(r":(?:class|func|meth|mod):<code>~?(.*?)</code>")
#: A case of the conformance suite: whether it intervenes, its name, its docstring.
CASE = re.compile(r'^(@pytest.mark.intervene\n)?def test_(\w+)\(.*?"""(.*?)"""', re.MULTILINE | re.DOTALL)
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


def table(name: str, found: dict[str, Any], all_: dict[str, Any], told: dict[str, str]) -> Iterator[str]:
    """Yield the lines of a table and of those within it; ``told`` has the places of those that are there already."""
    keys, needed = found.get("properties", {}), found.get("required", ())
    if name:
        yield f"\n## `{name}`\n\n{cell(found.get('description', ''))}\n"
    yield "| key | type | unit | default | meaning |\n|---|---|---|---|---|"
    below = {}
    for key, field in keys.items():
        value, told_of = field.get("default"), field.get("description", "")
        bare = value is None or value == [] or isinstance(value, dict)  # a table's keys have defaults of their own
        default = "needed" if key in needed else "" if bare else f"`{json.dumps(value)}`"
        unit = UNIT.search(told_of)
        meaning = [UNIT.sub("", told_of, count=1)]
        for part in dict.fromkeys(parts(field)):
            if part != "MonitorConfig":
                same = f"{name}.{key}".lstrip(".")
                below.update({} if part in told else {same: part})
                meaning += [f"keys: `{told.setdefault(part, same)}`"]
        cells = (kind(field), unit[1] if unit else "", default, "; ".join(filter(None, meaning)))
        yield f"| `{key}` | {' | '.join(map(cell, cells))} |"
    for inner, part in below.items():
        yield from table(inner, all_[part], all_, told)


def configuration() -> str:
    """Return the page of all keys but those of monitors."""
    document = schema()
    return "\n".join(["# All keys of a configuration\n", *table("", document, document["$defs"], {})])


def monitors() -> str:
    """Return the page of the parameters of all monitors."""
    all_ = schema()["$defs"]
    lines = ["# Parameters of monitors\n", "The keys of `[[monitor]]` beside `name` and `type`, type by type.\n"]
    for one in all_["MonitorConfig"]["anyOf"]:
        if name := one["properties"].pop("type").get("const"):
            lines += table(name, one, all_, {})
    return "\n".join(lines)


def cases() -> str:
    """Return the page of the cases of the conformance suite, by their docstrings: clause, then what is expected."""
    lines = [
        "# Cases of the conformance suite\n",
        "Those with a star need `--intervene` ([Test a server](../conformance.md)).",
    ]
    for file in sorted((DOCS.parent / "packages/gateway_conformance").glob("test_*.py")):
        lines.append(f"\n## `{file.name}`\n\n| case | clause | what is expected |\n|---|---|---|")
        for mark, name, told in CASE.findall(file.read_text()):
            clause, _, expected = " ".join(told.split()).partition(": ")
            lines.append(f"| `{name}`{' *' if mark else ''} | {cell(clause)} | {cell(expected)} |")
    return "\n".join(lines)


def python() -> str:
    """Return the page of the public names, which mkdocstrings fills from their docstrings."""
    lines = ["# Public names of Python\n", "[From Python](../api.md) shows ten uses of them."]
    for module in MODULES:
        lines.append(f"\n## `{module}`\n")
        for name in import_module(module).__all__:
            lines.append(f"::: {module}.{name}")
            if name == "Config":  # its keys have a page of their own
                lines.append("    options: {members: false}")
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
    made = {
        "configuration": configuration(),
        "monitors": monitors(),
        "commands": told,
        "python": python(),
        "cases": cases(),
    }
    for path, content in made.items():
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


def on_page_content(html: str, **_: Any) -> str:
    """Have roles of docstrings be the names that they refer to."""
    return ROLE.sub(r"<code>\1</code>", html)
