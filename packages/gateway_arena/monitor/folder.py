"""``gateway new-monitor NAME --from METHOD``: a folder in which a method of the arena is a monitor."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import gateway_api as api
from gateway.common.trust import add_own
from gateway_arena.methods import METHODS, method
from gateway_arena.monitor.fit import fitted, refuse
from gateway_arena.monitor.runner import collecting
from gateway_fdi.common.resources import shipped

_TEMPLATE, _COPIED = "examples/battery_voltage", ("battery.dbc", "battery_ecu.py")
#: Differences from the example: the monitor; times, for a method settles for 24 s [s].
_MONITOR = """type = "method"
method = "{method}"
inputs = ["BATT.Voltage"]
period_ms = 100.0
fitted = "{name}.fit"
{faults}codes = {{ {code} = "P0562" }}
"""
_TIMES = {
    "for five seconds": "for 20 seconds", "duration_s = 20.0": "duration_s = 120.0", "from_s = 5.0": "from_s = 60.0",
    "to_s = 10.0": "to_s = 80.0", "after_s = 5.0": "after_s = 60.0", " = 6.0": " = 80.0", "s = 12.0": "s = 115.0",
    "P0562-16": "P0562-00",
}  # fmt: skip
_HEALTHY = {
    '"drained"': '"healthy"', "drained for 20 seconds; it is named, and heals": "well", "s = 120.0": "s = 600.0",
}  # fmt: skip
_README = """# {name}: a method of the arena as a monitor

| file | what |
|---|---|
| `gateway.toml` | a gateway with it: `type = "method"` |
| `{name}.fit` | what it has learned of `healthy.log`; `gateway fit gateway.toml healthy.log{option}` makes it again |
| `drained.toml` | a scenario: a fault, and the DTC expected |

```console
$ gateway check gateway.toml
$ gateway demo drained.toml
```

For your own signals: put your database, `inputs` and `period_ms` into `gateway.toml`, and fit again on a healthy log
of yours. How it works: docs/arena.md.
"""


def new_monitor_from(name: str, place: Path, wanted: str) -> list[str]:
    """Write a folder; returns the names of its files.

    Args:
        name: of the monitor.
        place: the folder, which is there and empty.
        wanted: a method's name, or ``FILE.py:CLASS``.

    Raises:
        InputError: no such method; one that is a monitor already, or that cannot be fitted to one signal.
    """
    made = method(wanted)
    refuse(wanted, made, key="--from")
    supervised = bool(getattr(made, "supervised", False))
    place.mkdir(parents=True, exist_ok=True)
    own = wanted
    if wanted not in METHODS:
        path, _, kind = wanted.rpartition(":")
        (place / Path(path).name).write_bytes(Path(path).read_bytes())
        own = f"{Path(path).name}:{kind}"
    for file in _COPIED:
        (place / file).write_text((shipped(_TEMPLATE) / file).read_text())
    faults = 'faults = ["drained"]\n' if supervised else ""
    monitor = _MONITOR.format(name=name, method=own, faults=faults, code="drained" if supervised else "abnormal")
    old = 'type = "battery_voltage:MONITOR"\nlow = 11.0\n'
    config, drained = place / "gateway.toml", place / "drained.toml"
    config.write_text(_changed("gateway.toml", {old: monitor, '"battery"': f'"{name}"'}))
    whole = _changed("drained.toml", _TIMES)
    (place / "healthy.toml").write_text(_changed("drained.toml", _TIMES | _HEALTHY).partition("\n[[fault]]")[0])
    drained.write_text(whole.partition("\n[[expect]]")[0])
    for file in ("healthy.toml", "drained.toml") if supervised else ("healthy.toml",):
        with collecting():
            api.simulate(place / file, record=(place / file).with_suffix(".log"))
    drained.write_text(whole)
    told = [f"drained={place / 'drained.log'}@60"] if supervised else []
    fitted(config, [place / "healthy.log"], monitor=None, faults=told)
    option = " --fault drained=drained.log@60" if supervised else ""
    (place / "README.md").write_text(_README.format(name=name, option=option))
    add_own(place.glob("*.py"))
    return sorted(file.name for file in place.iterdir() if file.is_file())


def _changed(file: str, otherwise: Mapping[str, str]) -> str:
    """Return the text of a file of the example, with some words changed."""
    text = (shipped(_TEMPLATE) / file).read_text()
    for old, new in otherwise.items():
        assert old in text, (file, old)
        text = text.replace(old, new)
    return text
