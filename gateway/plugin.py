"""Plug-in of another package: one object, named by an entry point of the group ``gateway.plugins``.

::

    [project.entry-points."gateway.plugins"]
    coolant = "coolant.plugin:PLUGIN"

Everything outside the core comes through this door: the plants, the bench and the fleet of this project as well as the
packages of others. Each thing is named by its place, ``"package.module:NAME"``, and imported when it is first used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields

#: Version of this object. A plug-in says for which it was written.
API = 1

Places = Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Plugin:
    """Contents of a package: in each mapping its name -> ``"package.module:NAME"``.

    Attributes:
        api: :data:`API` as it was when the package was written, as a number; a package that says nothing is of 1.
        monitors: types of monitor (``gateway.monitors.contract.Monitor`` or ``Family``).
        ecus: types of virtual ECU (``gateway_bench.vecu.contract.VirtualEcu``, or a class with ``step``).
        commands: of the command line, each a function or a ``typer.Typer``; two words for one of a group, as
            ``"convert teeth"``.
        calls: functions that the core or ``gateway_api`` calls, whose work lies above them (``gateway.common.calls``).
        measures: measurements of ``gateway doctor --bench`` (``gateway_commands.doctor.Measure``).
        readers: of log formats, by suffix, as ``".xyz"`` (``gateway.bus.readers.batch.Reader``).
        formats: of logs that are read and written, by suffix (``gateway.bus.log_format.LogFormat``).
        protections: carmakers' rules of checksums: name in ``checksum.rule`` -> function of a
            ``gateway.signals.protection.rules.Frame`` that returns the checksum.
        keys: key functions of UDS security access: of seed, secret and level.
        servers: on a bus, for tables ``[[server]]`` (``gateway.servers.types.ServerType``).
        sections: tables ``[output.NAME]`` of a configuration (``gateway.servers.section.Section``).
        observers: values that ``gateway learn`` shows of a message beside its signals
            (``gateway_fleet.learn.observers.Observer``).
    """

    api: int = 1
    monitors: Places = field(default_factory=dict)
    ecus: Places = field(default_factory=dict)
    commands: Places = field(default_factory=dict)
    calls: Places = field(default_factory=dict)
    readers: Places = field(default_factory=dict)
    formats: Places = field(default_factory=dict)
    protections: Places = field(default_factory=dict)
    keys: Places = field(default_factory=dict)
    measures: Places = field(default_factory=dict)
    observers: Places = field(default_factory=dict)
    servers: Places = field(default_factory=dict)
    sections: Places = field(default_factory=dict)

    @staticmethod
    def joined(parts: Iterable[Plugin]) -> Plugin:
        """Return one object for several.

        Raises:
            ValueError: two of them have the same name for two things.
        """
        found: dict[str, dict[str, str]] = {door: {} for door in DOORS.values()}
        for part in parts:
            for door, places in found.items():
                for name, place in getattr(part, door).items():
                    if places.setdefault(name, place) != place:
                        raise ValueError(f"two {door} are called {name}: {places[name]} and {place}")
        return Plugin(**found)  # type: ignore[arg-type]


#: Group of entry points -> the attribute of a :class:`Plugin` that is the same door.
DOORS = {"gateway.vecu": "ecus"} | {
    f"gateway.{each.name}": each.name for each in fields(Plugin) if each.name not in ("api", "ecus")
}
