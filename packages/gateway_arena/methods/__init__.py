"""Methods of the arena, by name; and one of a stranger's from a file."""

from __future__ import annotations

import hashlib
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from gateway import __version__
from gateway.common.extras import need
from gateway.common.trust import verified
from gateway_arena.contract import Method, Stepped
from gateway_fdi.errors import InputError, nearest

#: Name -> place; ours first.
METHODS = {
    "structural": "structural:Structural",
    "courses": "courses:Courses",
    "pi_bank": "bank:Bank",
    "fixed": "structural:Fixed",
    "selected": "residual_selection:Selected",
    "toolbox": "toolbox:Toolbox",
    "ekf": "extended_kalman:Ekf",
    "pca": "machine_learning:Pca",
    "svm": "machine_learning:Svm",
    "forest": "machine_learning:Forest",
    "kalman": "filters:Kalman",
}


def method(name: str) -> Method:
    """Return a method, not fitted.

    Args:
        name: of :data:`METHODS`, or ``FILE.py:CLASS``.

    Raises:
        InputError: there is none; its file cannot be loaded, or is not trusted; its class has neither ``step`` nor
            ``run``.
    """
    if name in METHODS:
        module, _, kind = METHODS[name].partition(":")
        if module in ("machine_learning", "residual_selection"):
            need("arena", "methods that learn from data", key="--method")
        if module in ("structural", "courses", "residual_selection", "extended_kalman", "toolbox"):
            need("structure", "equations", key="--method")
        made: Method = getattr(import_module(f"{__name__}.{module}"), kind)()
        return made
    path, _, kind = name.rpartition(":")
    if not path.endswith(".py"):
        raise InputError(
            f"the methods are {', '.join(METHODS)}, or FILE.py:CLASS{nearest(name, METHODS)}",
            key="--method",
            value=name,
        )
    return _strangers(Path(path), kind)


def source_of(name: str) -> str:
    """Return what a method's code is known by: its file's digest, or the version of this package.

    Raises:
        InputError: the file cannot be read.
    """
    path, _, kind = name.rpartition(":")
    if name in METHODS:
        return __version__
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise InputError("no such file", file=path or name, key="--method", value=f"{path}:{kind}") from error


def _strangers(path: Path, kind: str) -> Method:
    # By this name what it has learned is pickled, and found again in another process.
    name = f"gateway_method_{source_of(f'{path}:{kind}')[:16]}"
    code = verified(path)
    try:
        if name not in sys.modules:
            sys.modules[name] = module = ModuleType(name)
            module.__file__ = str(path)
            exec(compile(code, path, "exec", dont_inherit=True), module.__dict__)
        made: Any = getattr(sys.modules[name], kind)()
    except Exception as error:
        sys.modules.pop(name, None)
        raise InputError(f"{type(error).__name__}: {error}", file=path, key="--method", value=kind) from error
    if not hasattr(made, "fit") or not (hasattr(made, "step") or hasattr(made, "run")):
        raise InputError("a method has fit, and step or run", file=path, key="--method", value=kind)
    return made if hasattr(made, "run") else Stepped(made)
