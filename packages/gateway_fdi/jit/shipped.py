"""Compiled kernels that come with the package: only authors of kernels compile.

``precompiled/index.json`` of a package names for each entry the key of the closure that it was made from, and the
digests of the files in which this closure can lie. While these files are as they were, the key need not be computed; if
one has changed, it is, and the shipped code is used if the kernels themselves have not. ``scripts/precompile`` makes
all of it.
"""

from __future__ import annotations

import hashlib
import json
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

from gateway_fdi.jit.cache import Code

#: The folder in which packages lie that ship code: this one's.
_PACKAGE = Path(__file__).parent.parent


@cache
def package(name: str) -> Path:
    """Return the folder of a package by its name; the package need not be imported."""
    if name == _PACKAGE.name:
        return _PACKAGE
    module = sys.modules.get(name)
    found = getattr(module, "__file__", None) if module is not None else None
    if found is None:
        spec = find_spec(name)
        found = spec.origin if spec is not None else None
    return Path(found).parent if found is not None else _PACKAGE / name


@cache
def _index(name: str) -> dict[str, Any]:
    try:
        file = package(name) / "precompiled" / "index.json"
        return cast("dict[str, Any]", json.loads(file.read_text()))
    except FileNotFoundError:
        return {"files": [], "entries": {}}


@cache
def file_digest(name: str) -> str:
    """Return the digest of a file, ``package/folder/module.py``; "" if it is not there."""
    owner, _, rest = name.partition("/")
    try:
        data = (package(owner) / rest).read_bytes()
    except OSError:
        return ""
    return hashlib.blake2b(data, digest_size=8).hexdigest()


def entry(kernel: str, signature: str) -> dict[str, Any] | None:
    """Return what is shipped for a kernel and a signature, None if nothing is.

    Args:
        kernel: ``module:name``.
        signature: digest of its forms.
    """
    entries = _index(kernel.partition(".")[0])["entries"]
    return cast("dict[str, Any] | None", entries.get(f"{kernel} {signature}"))


def unchanged(found: dict[str, Any]) -> bool:
    """Return whether the files that an entry can come from are as they were."""
    files = _index(found["package"])["files"]
    return all(file_digest(files[k][0]) == files[k][1] for k in found["files"])


def survey() -> tuple[int, int]:
    """Return how many entries come with the gateway, and how many of these have sources that were changed since."""
    names = sorted(file.parent.parent.name for file in _PACKAGE.parent.glob("gateway*/precompiled/index.json"))
    entries = [found for name in {*names, "gateway"} for found in _index(name)["entries"].values()]
    return len(entries), sum(not unchanged(found) for found in entries)


def code(found: dict[str, Any], level: str) -> Code | None:
    """Return the object code of an entry, None if there is none for this level, or it is damaged."""
    return _read(found, f"{level}/{found['name']}.o", found["objects"].get(level))


def bitcode(found: dict[str, Any]) -> Code | None:
    """Return the bitcode of an entry, from which code for any machine can be made; None if it is damaged."""
    return _read(found, f"bitcode/{found['name']}.bc", found["bitcode"])


def _read(found: dict[str, Any], name: str, digest: str | None) -> Code | None:
    try:
        data = (package(found["package"]) / "precompiled" / name).read_bytes()
    except OSError:
        return None
    if digest is None or hashlib.blake2b(data, digest_size=8).hexdigest() != digest:
        return None
    return Code(found["symbol"], found["results"], tuple(found["needs"]), data)
