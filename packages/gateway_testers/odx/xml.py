"""Elements of ODX, and the file that they are packed into; equal elements are equal bytes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.etree.ElementTree import Element, indent, tostring

from gateway.common.archives import packed

_XSI = "http://www.w3.org/2001/XMLSchema-instance"
#: Characters that XML does not have.
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")


def node(tag: str, *children: Element | str | None, **attributes: object) -> Element:
    """Return an element.

    Args:
        tag: its name.
        children: elements, or its text; None is left out.
        attributes: by their names with "_" for "-"; ``type`` is ``xsi:type``.
    """
    made = Element(tag, {"xsi:type" if k == "type" else k.replace("_", "-"): str(v) for k, v in attributes.items()})
    for child in children:
        if isinstance(child, str):
            made.text = _CONTROL.sub("?", child)
        elif child is not None:
            made.append(child)
    return made


def group(tag: str, children: list[Element]) -> Element | None:
    """Return an element with these children; None: there are none."""
    return node(tag, *children) if children else None


def short(name: str) -> str:
    """Return a name as ODX has it: letters, digits, underscores, 128 at most."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name)[:128]


def free(name: str, taken: set[str]) -> str:
    """Return a name as ODX has it that is not taken yet, and take it."""
    base = made = short(name)
    number = 2
    while made in taken:
        made, number = f"{base[:120]}_{number}", number + 1
    taken.add(made)
    return made


def named(tag: str, name: str, *children: Element | str | None, long: str = "", **attributes: object) -> Element:
    """Return an element with a short name, and with a long one if it says more."""
    longer = node("LONG-NAME", long) if long and long != name else None
    return node(tag, node("SHORT-NAME", name), longer, *children, **attributes)


def package(name: str, files: Mapping[str, Element]) -> bytes:
    """Return a PDX file.

    Args:
        name: of the database.
        files: name of a file, with its suffix -> the content of its ODX element.
    """
    blocks = [
        named(
            "ABLOCK",
            short(file),
            node(
                "FILES",
                node(
                    "FILE",
                    file,
                    CREATION_DATE="1980-01-01T00:00:00",
                    MIME_TYPE=f"application/x-asam.odx.{file.rpartition('.')[2]}",
                ),
            ),
            UPD="UNCHANGED",
        )
        for file in files
    ]
    index = named("CATALOG", name, node("ABLOCKS", *blocks), F_DTD_VERSION="ODX-2.2.0")
    odx = {file: node("ODX", content, MODEL_VERSION="2.2.0") for file, content in files.items()}
    written: dict[str, bytes] = {}
    for file, content in {"index.xml": index, **odx}.items():
        content.set("xmlns:xsi", _XSI)
        content.set("xsi:noNamespaceSchemaLocation", "odx-cc.xsd" if content is index else "odx.xsd")
        indent(content, " ")
        written[file] = tostring(content, encoding="UTF-8", xml_declaration=True) + b"\n"
    return packed(written)
