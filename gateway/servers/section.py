"""Tables ``[output.NAME]`` of a configuration that other packages bring, and what becomes of them.

A package names an object of :class:`Section` by the plug-ins' door ``sections``; the name there is that of the table.
The configuration is joined of all that are installed, so that a table without its package is an unknown key.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from gateway.common.plugins import Registry, accept_instance
from gateway.faults.memory import FaultMemory
from gateway.servers.access import Need
from gateway.servers.application import Application
from gateway.servers.authority import Authority
from gateway.servers.bus_server import BusServer
from gateway.servers.identifiers import Identifiers
from gateway.servers.uds.params import UdsParams
from gateway.servers.uds.testers import Testers
from gateway_fdi.common.tomlfile import StrictModel

P = TypeVar("P", bound=StrictModel)
#: Version of this contract.
API = 1
#: Index of a bus where a table has no key ``bus``.
NO_BUS = -1


class Surroundings(NamedTuple):
    """Parts of a gateway that a server is made of.

    Attributes:
        bus: index of its bus; NO_BUS: the table has no key ``bus``.
        bus_name: name of that; "": none.
        memory: to read DTCs from.
        identifiers: data that testers read.
        authority: says who may intervene, and does it.
        testers: makes a session of UDS for each tester.
        uds: the table ``[output.uds]``; None: there is none.
        opened: what :meth:`Section.opened` returned.
    """

    bus: int
    bus_name: str
    memory: FaultMemory
    identifiers: Identifiers
    authority: Authority
    testers: Testers
    uds: UdsParams | None
    opened: Any


class Section(Generic[P]):
    """A table ``[output.NAME]``. It leaves what it does not need as it is here.

    A table with a key ``bus`` sends on that bus. All keys that methods return are those below the table, as
    ``pid[2].signal``.
    """

    #: Its keys, and what it is, for the JSON Schema.
    params: type[P]
    description: str
    #: Its name for people, as in ``by DoIP``.
    title: str
    #: Other tables of ``[output]`` that it needs -> the reason.
    needs: Mapping[str, str] = {}
    #: Version of the contract that it is written for.
    api = API

    def placed(self, params: P, folder: Path) -> P:
        """Return its keys with files relative to the configuration's folder."""
        return params

    def opened(self, params: P) -> Any:
        """Return what is read of files once, before a gateway is built.

        Raises:
            InputError: a file that is wrong; with the whole path of its key.
        """
        return None

    def signals(self, params: P) -> Iterable[tuple[str, str]]:
        """Return the signals that it names, each with its key."""
        return ()

    def shown(self, params: P) -> Iterable[tuple[str, str]]:
        """Return the signals that it shows of freeze frames of emission-related faults, each with its key."""
        return ()

    def routes(self, params: P) -> Mapping[str, str]:
        """Return the ECUs that testers reach by it, by the keys of the routes."""
        return {}

    def allows(self, params: P) -> Mapping[str, tuple[str, bool]]:
        """Return interventions without sessions (``[access]``) that a key of its own allows or not: key, allowed."""
        return {}

    def identifiers(self, params: P) -> Iterable[int]:
        """Return identifiers of its frames with EXTENDED, which belong to its bus; those of ISO-TP are known."""
        return ()

    def j1939_address(self, params: P) -> int | None:
        """Return the address that it claims on its bus; None: it does not speak J1939."""
        return None

    def server(self, params: P, around: Surroundings) -> BusServer | None:
        """Return the server; None: there is none."""
        return None

    def door(self, params: P, gateway: Any, clock: Any) -> Any:
        """Return the door of a daemon by which its testers come (``gateway.live.listeners.TableDoor``); None: none."""
        return None

    def reach(self, params: P, need: Need) -> Iterable[str]:
        """Return who reaches what by it, for ``gateway check``, one line each.

        Args:
            params: its keys.
            need: of what does more than read, by a route.
        """
        return ()

    def ways_around(self, params: P) -> Iterable[str]:
        """Return the ways by which something is easier than it looks, one line each."""
        return ()


class IsotpSection(Section[P], ABC):
    """A table of an application on ISO-TP: its keys are those of ``IsoTpParams`` and more; UDS may have its address."""

    @abstractmethod
    def application(self, params: P, around: Surroundings) -> Application:
        """Return the application."""


#: All sections, by the names of their tables.
SECTIONS: Registry[Section[Any]] = Registry("gateway.sections", accept_instance(Section, API))


def usable() -> dict[str, Section[Any]]:
    """Return the sections that can be used, by their names; ``gateway doctor`` tells of the others."""
    return {name: found for name, found in SECTIONS.described().items() if isinstance(found, Section)}
