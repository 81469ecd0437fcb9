"""Bulk data: frames recorded around failures, as candump logs."""

from __future__ import annotations

import zlib
from datetime import datetime
from typing import Literal

from starlette.responses import Response

from gateway.faults.records import Recording
from gateway_serve.sovd import faults
from gateway_serve.sovd.components import OWN
from gateway_serve.sovd.errors import SovdError
from gateway_serve.sovd.model import Model
from gateway_serve.sovd.table import Call, Endpoint

CATEGORY = "recordings"
_TYPE = "text/plain"


class Categories(Model):
    """Kinds of bulk data."""

    items: list[Literal["recordings"]]


class BulkItem(Model):
    """A recording."""

    id: str
    name: str
    mimetype: Literal["text/plain"] = "text/plain"
    size: int
    creation_date: datetime | None


class BulkList(Model):
    """Recordings."""

    items: list[BulkItem]


async def _categories(call: Call) -> Categories:
    return Categories(items=["recordings"] if call.state.component(call.path).id == OWN else [])


async def _recordings(call: Call) -> dict[str, tuple[str, Recording]]:
    """Return name and recording by id."""
    if call.state.component(call.path).id != OWN or call.path["category"] != CATEGORY:
        raise SovdError(404, "there is no such category")
    found: dict[str, tuple[str, Recording]] = {}
    for each in (await faults.of(call)).values():
        if each.entry["recordings"]:
            recordings = await call.state.hub.recordings(each.entry["dtc"])
            name = f"{each.entry['dtc']}: frames around the failure"
            found |= {f"{each.code}-{k}.log": (name, one) for k, one in enumerate(recordings, start=1)}
    return found


async def _list(call: Call) -> BulkList:
    return BulkList(
        items=[
            BulkItem(id=key, name=name, size=len(zlib.decompress(one.log)), creation_date=faults.instant(one.t_ns))
            for key, (name, one) in (await _recordings(call)).items()
        ]
    )


async def _read(call: Call) -> Response:
    found = await _recordings(call)
    key = call.path["bulk_data_id"]
    if key not in found:
        raise SovdError(404, "there is no such recording")
    headers = {"content-disposition": f'attachment; filename="{key}"'}
    return Response(zlib.decompress(found[key][1].log), media_type=_TYPE, headers=headers)


_PATH = "/components/{component_id}/bulk-data"
ENDPOINTS = (
    Endpoint("GET", _PATH, "Kinds of bulk data", _categories, Categories),
    Endpoint("GET", _PATH + "/{category}", "Recordings", _list, BulkList),
    Endpoint("GET", _PATH + "/{category}/{bulk_data_id}", "A recording", _read, media=_TYPE),
)
