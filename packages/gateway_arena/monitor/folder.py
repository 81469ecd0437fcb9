"""``gateway new-monitor NAME --from METHOD``: a folder in which a method of the arena is a monitor."""

from __future__ import annotations

from pathlib import Path

from gateway import api
from gateway.common.trust import add_own
from gateway_arena.methods import METHODS, method
from gateway_arena.monitor.fit import fitted, refuse
from gateway_arena.monitor.runner import collecting
from gateway_fdi.common.resources import shipped

_TEMPLATE, _COPIED = "examples/battery_voltage", ("battery.dbc", "battery_ecu.py")
#: Length of the healthy drive, of the other ones, and when a fault begins and ends in them [s].
_HEALTHY_S, _SECONDS, _FROM_S, _TO_S = 600.0, 120.0, 60.0, 80.0
_CONFIG = """name = "{name}"

[[bus]]
name = "can"
uri = "socketcan:vcan0"
database = ["battery.dbc"]

[[bus.check]]
message = "BATT"
timeout_ms = 500.0

[[monitor]]
name = "{name}"
type = "method"
method = "{method}"
inputs = ["BATT.Voltage"]
period_ms = 100.0
fitted = "{name}.fit"
{faults}codes = {{ {code} = "P0562" }}

[output.dtc_frame]
cycle_ms = 1000.0
"""
_SCENARIO = """name = "{title}"
description = "{text}"
duration_s = {seconds}
config = "gateway.toml"

[[ecu]]
type = "battery_ecu:ECU"
"""
_FAULT = """
[[fault]]
kind = "drained"
from_s = {from_s}
to_s = {to_s}
volts = 10.5
"""
_EXPECT = """
[[expect]]
dtc = "P0562-00"
after_s = {from_s}
by_s = {by_s}
healed_by_s = {healed_by_s}
"""
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
    config = place / "gateway.toml"
    config.write_text(
        _CONFIG.format(name=name, method=own, faults=faults, code="drained" if supervised else "abnormal")
    )
    ecu = {"healthy": (_HEALTHY_S, "The battery is well."), "drained": (_SECONDS, "The battery is drained.")}
    for title, (seconds, text) in ecu.items():
        bad = title != "healthy"
        whole = _SCENARIO.format(title=title, text=text, seconds=seconds)
        whole += _FAULT.format(from_s=_FROM_S, to_s=_TO_S) if bad else ""
        (place / f"{title}.toml").write_text(whole)
        if supervised or not bad:
            with collecting():
                api.simulate(place / f"{title}.toml", record=place / f"{title}.log")
    with (place / "drained.toml").open("a") as file_:
        file_.write(_EXPECT.format(from_s=_FROM_S, by_s=_TO_S, healed_by_s=_SECONDS - 5.0))
    told = [f"drained={place / 'drained.log'}@{_FROM_S:g}"] if supervised else []
    fitted(config, [place / "healthy.log"], monitor=None, faults=told)
    option = f" --fault drained=drained.log@{_FROM_S:g}" if supervised else ""
    (place / "README.md").write_text(_README.format(name=name, option=option))
    add_own(place.glob("*.py"))
    return sorted(file.name for file in place.iterdir() if file.is_file())
