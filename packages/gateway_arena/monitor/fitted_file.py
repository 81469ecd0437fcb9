"""A fitted method in a file: a line of JSON that says what it is of, and the method, pickled.

All that the line says is checked before anything is unpickled, which runs code as the method's own file does: both must
be trusted (:mod:`gateway.common.trust`). ``gateway fit`` trusts what it has written itself.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gateway.common import trust
from gateway_arena.contract import Method
from gateway_arena.methods import method, source_of
from gateway_arena.monitor.params import Params
from gateway_fdi.errors import InputError

_FORMAT = 1
#: Packages whose fitted objects are another version's no more.
_PACKAGES = {"sklearn": "scikit-learn", "torch": "torch", "filterpy": "filterpy"}


@dataclass(frozen=True)
class Kept:
    """A fitted method.

    Attributes:
        threshold: score above which it alarms.
        low: smallest values of the inputs that it takes, shape (inputs,).
        high: largest ones.
        told: what the fit said, for people.
        payload: the method, pickled.
    """

    threshold: float
    low: tuple[float, ...]
    high: tuple[float, ...]
    told: str
    payload: bytes


def _place_of(name: str, folder: Path) -> str:
    """Return a method's name with its file beside the configuration."""
    path, _, kind = name.rpartition(":")
    return f"{folder / path}:{kind}" if path.endswith(".py") else name


def method_of(p: Params, folder: Path) -> tuple[Method, str]:
    """Return the method of parameters, not fitted, and what its code is known by.

    Raises:
        InputError: there is none.
    """
    place = _place_of(p.method, folder)
    try:
        return method(place), source_of(place)
    except InputError as error:
        raise InputError(error.message, file=error.file, key="method", value=p.method) from error


def _facts(p: Params, folder: Path) -> dict[str, Any]:
    """Return what a file must have been fitted for."""
    return {
        "format": _FORMAT,
        "method": p.method,
        "source": method_of(p, folder)[1],
        "inputs": list(p.inputs),
        "faults": list(p.faults),
        "period_ms": p.period_ms,
        "settle": p.settle,
    }


def _versions() -> dict[str, str]:
    """Return the versions of the packages that are in this process, without their last part."""
    found = {"python": f"{sys.version_info[0]}.{sys.version_info[1]}"}
    return found | {
        name: ".".join(version(name).split(".")[:2]) for module, name in _PACKAGES.items() if module in sys.modules
    }


def write(path: Path, p: Params, folder: Path, made: Any, facts: Mapping[str, Any]) -> None:
    """Write a fitted method, at once or not at all.

    Args:
        path: the file.
        p: parameters that it was fitted for.
        folder: of the configuration.
        made: the method.
        facts: threshold, low, high, told.

    Raises:
        InputError: it cannot be pickled, or not be written.
    """
    try:
        payload = pickle.dumps(made)
    except Exception as error:
        text = f"what it has learned cannot be kept: {type(error).__name__}: {error}"
        raise InputError(text, key="method", value=p.method) from error
    digest = hashlib.sha256(payload).hexdigest()
    line = {**_facts(p, folder), **facts, "versions": _versions(), "sha256": digest}
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(json.dumps(line).encode() + b"\n" + payload)
        part.replace(path)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=path, key="fitted", value=p.fitted) from error
    trust.add_own([path])


def read(p: Params, folder: Path) -> Kept:
    """Return the fitted method of parameters; it is not unpickled.

    Raises:
        InputError: no such file; it is damaged, or of another method, other inputs or another version of a package.
    """
    facts = _facts(p, folder)
    path, again = folder / p.fitted, "gateway fit CONFIG LOG makes it"
    try:
        head, _, payload = trust.verified(path, "what it has learned").partition(b"\n")
    except OSError as error:
        raise InputError(f"{error.strerror}; {again}", file=path, key="fitted", value=p.fitted) from error
    try:
        line = json.loads(head)
        kept = Kept(float(line["threshold"]), tuple(line["low"]), tuple(line["high"]), str(line["told"]), payload)
        given, versions, digest = {k: line[k] for k in facts}, dict(line["versions"]), line["sha256"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"no file of gateway fit; {again}", file=path, key="fitted", value=p.fitted) from error
    if hashlib.sha256(payload).hexdigest() != digest:
        raise InputError(f"it is damaged; {again} again", file=path, key="fitted", value=p.fitted)
    for key, value in facts.items():
        if given[key] != value:
            shown = "another text of its file" if key == "source" else f"{key} = {given[key]!r}"
            raise InputError(f"it was fitted for {shown}; {again} again", file=path, key=key, value=value)
    now = _versions()
    for name, was in versions.items():
        if now.get(name) not in (None, was):
            text = f"it was fitted with {name} {was}; {again} again"
            raise InputError(text, file=path, key="fitted", value=f"{name} {now[name]}")
    return kept


def load(kept: Kept, path: Path) -> Any:
    """Return the method, a new one with each call.

    Raises:
        InputError: it cannot be unpickled.
    """
    try:
        return pickle.loads(kept.payload)  # noqa: S301 - see above
    except Exception as error:
        raise InputError(f"cannot be read: {type(error).__name__}: {error}", file=path, key="fitted") from error
