"""Operations: routines of the gateway (0x31), and its restart (0x11), which begins the next operation cycle."""

from __future__ import annotations

from typing import Any, Literal

from gateway.servers.uds.services.x31_routine_control import COMPACT, RESTART_CYCLE, START
from gateway_serve.sovd.components import OWN, place
from gateway_serve.sovd.errors import SovdError
from gateway_serve.sovd.model import Body, Model
from gateway_serve.sovd.table import Call, Endpoint

#: Operations by id: routine and name.
_OPERATIONS = {
    "restart-cycle": (RESTART_CYCLE, "End the operation cycle and begin the next one"),
    "compact": (COMPACT, "Check the fault memory's file and compact it"),
}


class OperationItem(Model):
    """An operation; its executions end at once."""

    id: str
    name: str
    proximity_proof_required: bool = False
    asynchronous_execution: bool = False


class OperationList(Model):
    """Operations."""

    items: list[OperationItem]


class OperationShown(Model):
    """An operation, and where it is executed."""

    item: OperationItem
    executions: str


class Execute(Body):
    """No operation has parameters."""

    parameters: dict[str, Any] | None = None


class Executed(Model):
    """An execution that has ended, and its result as hexadecimal digits."""

    status: Literal["completed"] = "completed"
    parameters: dict[str, str]


class ExecutionList(Model):
    """Executions that go on: none."""

    items: list[OperationItem]


class StatusShown(Model):
    """Whether the gateway runs, and where it is restarted."""

    status: Literal["ready", "notReady"]
    restart: str


def _known(call: Call) -> dict[str, tuple[int, str]]:
    return _OPERATIONS if call.state.component(call.path).id == OWN else {}


def _item(call: Call) -> OperationItem:
    key = call.path["operation_id"]
    if key not in _known(call):
        raise SovdError(404, "there is no such operation")
    return OperationItem(id=key, name=_OPERATIONS[key][1])


async def _list(call: Call) -> OperationList:
    return OperationList(items=[OperationItem(id=key, name=name) for key, (_, name) in _known(call).items()])


async def _show(call: Call) -> OperationShown:
    item = _item(call)
    return OperationShown(item=item, executions=place("components", OWN, "operations", item.id, "executions"))


async def _executions(call: Call) -> ExecutionList:
    _item(call)
    return ExecutionList(items=[])


async def _execute(call: Call) -> Executed:
    item = _item(call)
    if call.body.parameters:
        raise SovdError(409, "parameters: this operation has none")
    number = _OPERATIONS[item.id][0].to_bytes(2, "big")
    answer = await call.state.locks.intervene(call.who, call.state.component(call.path), bytes([0x31, START]) + number)
    return Executed(parameters={"result": answer[4:].hex()})


async def _status(call: Call) -> StatusShown:
    if call.state.component(call.path).id != OWN:
        raise SovdError(404, "only of the gateway it is known whether it runs")
    ready = call.state.hub.connected and not call.state.hub.hello.get("ended")
    return StatusShown(status="ready" if ready else "notReady", restart=place("components", OWN, "status", "restart"))


async def _restart(call: Call) -> StatusShown:
    shown, one = await _status(call), call.state.component(call.path)
    await call.state.locks.intervene(call.who, one, b"\x11\x01")
    call.state.locks.own(call.who, one).forget_session()
    return shown


_PATH = "/components/{component_id}/operations"
_STATUS = "/components/{component_id}/status"
ENDPOINTS = (
    Endpoint("GET", _PATH, "Operations of a component", _list, OperationList),
    Endpoint("GET", _PATH + "/{operation_id}", "An operation", _show, OperationShown),
    Endpoint("GET", _PATH + "/{operation_id}/executions", "Executions that go on", _executions, ExecutionList),
    Endpoint("POST", _PATH + "/{operation_id}/executions", "Execute it", _execute, Executed, 200, Execute),
    Endpoint("GET", _STATUS, "Whether a component runs", _status, StatusShown),
    Endpoint("PUT", _STATUS + "/restart", "Begin the next operation cycle", _restart, StatusShown, 202),
)
