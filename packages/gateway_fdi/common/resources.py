"""Files that come with the gateway: databases, scenarios, configurations, models.

Databases and scenarios lie in folders of their own, in a sub-folder for each plant; configurations and models lie in
the package that they belong to. A file is asked for by its kind and its name, as ``configs/truck.toml``, wherever it
lies.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError, nearest

#: The folder in which the packages lie.
_PACKAGES = Path(__file__).parents[2]

#: Files that were called otherwise before version 0.2: one name for one plant since then.
_RENAMED = (
    (r"(scenarios|configs|dbc|bench)/hybrid(_|\.)", r"\1/truck\2"),
    (r"(scenarios|configs)/(aircraft|belt)", r"\1/linear_\2"),
    (r"(configs|dbc)/comma_pedal\.", r"\1/pedal_comma."),
    (r"dbc/plant\.", "dbc/linear."),
    (r"dbc/engine\.", "dbc/crank."),
    (r"models/hybrid_truck\.", "models/truck."),
)

_log = get_logger(__name__)


def renamed(name: str) -> str | None:
    """Return what a shipped file is called now, None if it never had another name."""
    for old, new in _RENAMED:
        now = re.sub(f"^{old}", new, name)
        if now != name:
            return now
    return None


def _places(name: str) -> Iterator[Path]:
    """Yield where a shipped file, or all of a pattern, can lie.

    In a checkout databases and scenarios are beside the folder of the packages, in a wheel in ``gateway/shipped``.
    """
    folder, _, rest = name.rpartition("/")
    for root in (_PACKAGES / "gateway" / "shipped", _PACKAGES.parent):
        if not (root / "gateway.toml").is_file():
            continue
        yield from sorted(root.glob(name))
        if folder:
            yield from sorted(root.glob(f"{folder}/*/{rest}"))
    if folder:
        yield from sorted(_PACKAGES.glob(f"gateway_*/{name}"))
        yield from sorted(_PACKAGES.glob(f"gateway_*/*/{name}"))


def shipped(name: str) -> Path:
    """Return the path of a shipped file, e.g. ``dbc/gateway.dbc``.

    Raises:
        InputError: there is no such file.
    """
    path = next(_places(name), None)
    if path is not None:
        return path
    now = renamed(name)
    if now is not None:
        found = shipped(now)
        _log.warning("renamed", file=name, now=now)
        return found
    raise InputError("no such file comes with the gateway", value=name)


def all_shipped(folder: str, suffix: str) -> list[Path]:
    """Return all shipped files of a kind, by name.

    Args:
        folder: the kind, e.g. ``dbc``.
        suffix: of the files, e.g. ``.dbc``.
    """
    return sorted(_places(f"{folder}/*{suffix}"), key=lambda path: path.name)


def beside_or_shipped(folder: Path, name: Path) -> Path:
    """Return a file that another one names: relative to that one's folder, else a shipped one of this name.

    Args:
        folder: of the file that names it.
        name: as it is named there; behind a ``#`` may be a part of the file.

    Returns:
        A path that need not exist: that beside the file, if there is neither.
    """
    beside = folder / name
    file, sign, part = name.name.rpartition("#")
    if sign and file and not beside.exists():
        found = beside_or_shipped(folder, name.with_name(file))
        return found.with_name(f"{found.name}#{part}")
    if beside.exists() or name.is_absolute() or ".." in name.parts:
        return beside
    return next(_places(name.as_posix()), beside)


def find(path: Path, folder: Path, kind: str, suffix: str, *, beside: str, key: str) -> Path:
    """Return a file that another one names: in that one's folder, else one that comes with the gateway.

    Args:
        path: as it was told.
        folder: of the file that tells it.
        kind: folder of the shipped ones, e.g. ``models``; it may be a part of the path.
        suffix: of these, e.g. ``.toml``.
        beside: the file that tells it, for people.
        key: of that file.

    Raises:
        InputError: there is neither.
    """
    found = beside_or_shipped(folder, path)
    if found.exists():
        return found
    begins = "" if path.parent.name == kind else f"{kind}/"
    try:
        return shipped(f"{begins}{path}")
    except InputError as error:
        known = [f"{kind}/{each.name}".removeprefix(begins) for each in all_shipped(kind, suffix)]
        text = f"no such file beside {beside}, and the gateway comes with {', '.join(known)} only"
        raise InputError(f"{text}{nearest(str(path), known)}", key=key, value=str(path)) from error
