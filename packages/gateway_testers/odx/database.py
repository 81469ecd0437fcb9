"""The whole database: protocols, a base variant with the services, a variant of its own, and their parameters."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree.ElementTree import Element

from gateway.servers.uds.nrc import Nrc
from gateway_testers.doip.params import DoipParams
from gateway_testers.odx import comparams
from gateway_testers.odx.data import Served
from gateway_testers.odx.layer import Layer
from gateway_testers.odx.services import add_services, charts
from gateway_testers.odx.xml import named, node, package, short

#: Negative response codes as testers see them.
_REFUSALS: Mapping[int, str] = {nrc: nrc.name.lower().replace("_", " ") for nrc in Nrc}


def pdx(name: str, served: Served, doip: DoipParams | None) -> bytes:
    """Return a PDX file of a gateway; the same one for the same configuration.

    Args:
        name: of the gateway.
        served: its UDS server, on its first address.
        doip: its DoIP server; None: there is none.
    """
    name = short(name) or "gateway"
    base_name = f"{name}_base"
    protocols = comparams.protocols_of(served.context.params, doip, base_name)
    layer = Layer(name, charts(served.context))
    add_services(layer, served)
    base = named(
        "BASE-VARIANT",
        base_name,
        *layer.content(_REFUSALS),
        comparams.refs(protocols),
        comparams.parents(protocols),
        ID=f"{name}.BASE",
    )
    files: dict[str, Element] = comparams.subsets(protocols)
    parent = node("PARENT-REFS", node("PARENT-REF", ID_REF=f"{name}.BASE", type="BASE-VARIANT-REF"))
    files[f"{name}.odx-d"] = named(
        "DIAG-LAYER-CONTAINER",
        name,
        node("PROTOCOLS", *map(comparams.layer_of, protocols)),
        node("BASE-VARIANTS", base),
        node("ECU-VARIANTS", named("ECU-VARIANT", name, parent, ID=f"{name}.VARIANT")),
        ID=f"{name}.CONTAINER",
    )
    return package(name, files)
