"""Compiled kernels that come with the package: nobody compiles who does not write kernels.

``gateway/precompiled/index.json`` names for each entry the key of the closure that it was made from, and the digests of
the files in which this closure can lie. While these files are as they were, the key need not be computed; if one has
changed, it is, and the shipped code is used if the kernels themselves have not. ``scripts/precompile`` makes all of it.
"""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any, cast

from gateway.jit.cache import Code

PACKAGE = Path(__file__).parent.parent
FOLDER = PACKAGE / "precompiled"


@cache
def _index() -> dict[str, Any]:
    try:
        return cast("dict[str, Any]", json.loads((FOLDER / "index.json").read_text()))
    except FileNotFoundError:
        return {"files": [], "entries": {}}


@cache
def file_digest(name: str) -> str:
    """Return the digest of a file of the package, "" if it is not there."""
    try:
        data = (PACKAGE / name).read_bytes()
    except OSError:
        return ""
    return hashlib.blake2b(data, digest_size=8).hexdigest()


def entry(kernel: str, signature: str) -> dict[str, Any] | None:
    """Return what is shipped for a kernel and a signature, None if nothing is.

    Args:
        kernel: ``module:name``.
        signature: digest of its forms.
    """
    return cast("dict[str, Any] | None", _index()["entries"].get(f"{kernel} {signature}"))


def unchanged(found: dict[str, Any]) -> bool:
    """Return whether the files that an entry can come from are as they were."""
    files = _index()["files"]
    return all(file_digest(files[k][0]) == files[k][1] for k in found["files"])


def survey() -> tuple[int, int]:
    """Return how many entries are shipped, and how many of these have sources that were changed since."""
    entries = _index()["entries"].values()
    return len(entries), sum(not unchanged(found) for found in entries)


def code(found: dict[str, Any], level: str) -> Code | None:
    """Return the object code of an entry, None if there is none for this level, or it is damaged."""
    return _read(found, f"{level}/{found['name']}.o", found["objects"].get(level))


def bitcode(found: dict[str, Any]) -> Code | None:
    """Return the bitcode of an entry, from which code for any machine can be made; None if it is damaged."""
    return _read(found, f"bitcode/{found['name']}.bc", found["bitcode"])


def _read(found: dict[str, Any], name: str, digest: str | None) -> Code | None:
    try:
        data = (FOLDER / name).read_bytes()
    except OSError:
        return None
    if digest is None or hashlib.blake2b(data, digest_size=8).hexdigest() != digest:
        return None
    return Code(found["symbol"], found["results"], tuple(found["needs"]), data)
