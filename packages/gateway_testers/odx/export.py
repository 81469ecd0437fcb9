"""A gateway as a PDX file: what testers can ask of its UDS server."""

from __future__ import annotations

from gateway.runtime.app import Gateway
from gateway.servers.diagnostic_server import DiagnosticServer
from gateway.servers.uds.server import UdsServer
from gateway_fdi.errors import InputError
from gateway_testers.odx.data import Served
from gateway_testers.odx.database import pdx


def pdx_of(gateway: Gateway) -> bytes:
    """Return the PDX file; the same one for the same configuration.

    Raises:
        InputError: there is no UDS server.
    """
    found = (server.uds for server in gateway.servers.all if isinstance(server, DiagnosticServer))
    uds = next((each for each in found if isinstance(each, UdsServer)), None)
    if uds is None:
        raise InputError("a PDX file describes the UDS server, and there is none", key="output.uds")
    plan = gateway.engine.plan
    names = {ref: f"{ref.message}.{ref.signal}" for ref in plan.slot_names}
    units = {names[ref]: unit for ref, unit in zip(plan.slot_names, plan.slot_units, strict=True)}
    units |= {name: plan.slot_units[slot] for name, slot in gateway.parts.slots.items()}
    inputs = {
        each.id: tuple(dict.fromkeys(names[ref] for ref in gateway.engine.inputs_of(k)))
        for k, each in enumerate(gateway.catalogue)
    }
    return pdx(gateway.config.name, Served(uds.context, units, inputs), gateway.config.output.tables.get("doip"))
