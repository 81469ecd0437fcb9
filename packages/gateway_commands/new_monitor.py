"""``gateway new-monitor``: a folder with a monitor of one's own, which runs as it is."""

from __future__ import annotations

import keyword
import re
from importlib.util import find_spec
from pathlib import Path

from gateway.common.trust import add_own
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError

#: The folder that is copied: a monitor that CI runs.
TEMPLATE = "examples/battery_voltage"
#: Files of it that are copied; the same monitor in plain Python, and its name there.
_KINDS = (".py", ".dbc", ".toml", ".ini", ".md")
_PLAIN, _NAME = "plain.py", re.compile(r"\bMONITOR\b")
#: Its names, and their replacements; the first that fits.
_NAMES = ("battery_voltage", "battery_ecu")


def new_monitor(name: str, folder: Path | None, method: str | None = None, *, plain: bool = False) -> int:
    """Write a folder; returns the exit code.

    Args:
        name: of the monitor.
        folder: to write; None: the name.
        method: of the arena, that is to be the monitor.
        plain: whether it is a function of plain Python.

    Raises:
        InputError: no name for a module of Python; the folder is there already.
    """
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InputError(
            "a name for a module of Python: small letters, digits, underscores",
            key="NAME",
            value=name,
        )
    place = folder or Path(name)
    if place.exists() and (not place.is_dir() or any(place.iterdir())):
        raise InputError("this is there already; nothing was written", value=str(place))
    if find_spec(name) is not None:
        raise InputError("a module of this name is installed already", key="NAME", value=name)
    if method is not None and plain:
        raise InputError("a method of the arena is plain Python already", key="--plain")
    if method is not None:
        from gateway.common.calls import CALLS  # noqa: PLC0415 - few are made of a method

        if "new_monitor_from" not in CALLS:
            raise InputError("no installed package brings methods", key="--from", value=method)
        print(f"{place}: {', '.join(CALLS['new_monitor_from'](name, place, method))}")
        print(f"It runs as it is:  cd {place} && gateway demo drained.toml --speed 0")
        return 0
    place.mkdir(parents=True, exist_ok=True)
    written = []
    for source in sorted(shipped(TEMPLATE).iterdir()):
        if source.suffix not in _KINDS or source.name == (f"{_NAMES[0]}.py" if plain else _PLAIN):
            continue
        target = place / _renamed(f"{_NAMES[0]}.py" if source.name == _PLAIN else source.name, name)
        text = _NAME.sub(_NAMES[0], source.read_text()) if plain else source.read_text()
        if source.suffix == ".toml":
            text = f"#:schema {'gateway' if source.stem == 'gateway' else 'scenario'}.schema.json\n{text}"
        target.write_text(_renamed(text, name))
        written.append(target.name)
    add_own(place.glob("*.py"))
    print(f"{place}: {', '.join(written)}")
    print(f"It runs as it is:  cd {place} && gateway demo drained.toml --speed 0")
    print(f"Then edit {name}.py, and trust it again (gateway trust {name}.py); gateway check says what does not fit.")
    return 0


def _renamed(text: str, name: str) -> str:
    return text.replace(_NAMES[0], name).replace(_NAMES[1], f"{name}_ecu")
