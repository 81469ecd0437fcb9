"""Entities: areas are buses, components the gateway and the ECUs, apps the monitors."""

from __future__ import annotations

from pydantic import Field

from gateway import __version__
from gateway_serve.sovd.components import BASE, OWN, Component, known, place
from gateway_serve.sovd.model import Item, Items, Model
from gateway_serve.sovd.table import Call, Endpoint


class VendorInfo(Model):
    """The program that serves."""

    name: str
    version: str


class SovdInfo(Model):
    """A version of the interface, and where it is."""

    version: str
    base_uri: str
    vendor_info: VendorInfo


class VersionInfo(Model):
    """The versions that are served."""

    sovd_info: list[SovdInfo]


class Area(Model):
    """A bus."""

    id: str
    name: str
    faults: str
    contains: str
    docs: str


class ComponentShown(Model):
    """The gateway, or an ECU; resources that it does not have are left out."""

    id: str
    name: str
    faults: str
    docs: str
    belongs_to: str | None = Field(None, alias="belongs-to")
    data: str | None = None
    configurations: str | None = None
    modes: str | None = None
    operations: str | None = None
    locks: str | None = None
    logs: str | None = None
    bulk_data: str | None = Field(None, alias="bulk-data")
    status: str | None = None
    cyclic_subscriptions: str | None = Field(None, alias="cyclic-subscriptions")
    triggers: str | None = None


class App(Model):
    """A monitor."""

    id: str
    name: str
    faults: str
    docs: str
    is_located_on: str = Field(alias="is-located-on")


#: Resources of the gateway, and of an ECU that is asked.
_OF_GATEWAY = (
    "data", "configurations", "modes", "operations", "locks", "logs", "bulk-data", "status", "cyclic-subscriptions",
    "triggers",
)  # fmt: skip
_OF_ECU = ("data", "modes", "locks")


async def version_info(call: Call) -> VersionInfo:
    """Return the versions that are served."""
    vendor = VendorInfo(name="ecu-gateway", version=__version__)
    return VersionInfo(sovd_info=[SovdInfo(version="1.1", base_uri=BASE, vendor_info=vendor)])


def _listed(kind: str, entities: dict[str, str]) -> Items:
    return Items(items=[Item(id=key, name=name, href=place(kind, key)) for key, name in entities.items()])


async def _areas(call: Call) -> Items:
    return _listed("areas", call.state.buses())


async def _area(call: Call) -> Area:
    key = call.path["area_id"]
    name = known(call.state.buses(), key, "area")
    return Area(id=key, name=name, **{part: place("areas", key, part) for part in ("faults", "contains", "docs")})


async def _contains(call: Call) -> Items:
    bus = known(call.state.buses(), call.path["area_id"], "area")
    inside = {one.id: one.name for one in call.state.components().values() if one.bus == bus}
    return _listed("components", inside)


async def _components(call: Call) -> Items:
    return _listed("components", {one.id: one.name for one in call.state.components().values()})


async def _component(call: Call) -> ComponentShown:
    one: Component = call.state.component(call.path)
    names = _OF_GATEWAY if one.id == OWN else _OF_ECU if one.ecu else ()
    areas = {name: key for key, name in call.state.buses().items()}
    return ComponentShown(
        id=one.id,
        name=one.name,
        **{"belongs-to": place("areas", areas[one.bus]) if one.bus in areas else None},
        **{part: place("components", one.id, part) for part in ("faults", "docs", *names)},
    )


async def _apps(call: Call) -> Items:
    return _listed("apps", call.state.monitors())


async def _app(call: Call) -> App:
    key = call.path["app_id"]
    name = known(call.state.monitors(), key, "app")
    places = {part: place("apps", key, part) for part in ("faults", "docs")}
    return App(id=key, name=name, **{"is-located-on": place("components", OWN)}, **places)


ENDPOINTS = (
    Endpoint("GET", "/version-info", "Versions that are served", version_info, VersionInfo),
    Endpoint("GET", "/areas", "Buses", _areas, Items),
    Endpoint("GET", "/areas/{area_id}", "A bus", _area, Area),
    Endpoint("GET", "/areas/{area_id}/contains", "Components on a bus", _contains, Items),
    Endpoint("GET", "/components", "The gateway and ECUs", _components, Items),
    Endpoint("GET", "/components/{component_id}", "A component", _component, ComponentShown),
    Endpoint("GET", "/apps", "Monitors", _apps, Items),
    Endpoint("GET", "/apps/{app_id}", "A monitor", _app, App),
)
