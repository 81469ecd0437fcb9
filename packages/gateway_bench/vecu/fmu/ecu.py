"""An FMU in a loop on the bus."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gateway.common.extras import need
from gateway_bench.vecu.contract import Run, Running, VirtualEcu
from gateway_bench.vecu.fmu.params import FmuParams
from gateway_bench.vecu.loop import Loop, sends
from gateway_bench.vecu.loop_params import LoopFault, fits
from gateway_fdi.errors import InputError


def _begin(params: FmuParams, faults: Sequence[LoopFault], run: Run) -> Running:
    need("fmu", "FMUs", key="type")
    from gateway_bench.vecu.fmu.model import FmuModel  # noqa: PLC0415 - an extra

    return Loop(params, faults, run, lambda: FmuModel(params, run.duration_s))


def _locate(params: FmuParams, folder: Path, key: str) -> FmuParams:
    """Return parameters whose FMU is that of the scenario's folder.

    Raises:
        InputError: there is no such file.
    """
    file = folder / params.file
    if not file.is_file():
        raise InputError("there is no such file", key=f"{key}.file", value=str(params.file))
    return params.model_copy(update={"file": file})


ECU = VirtualEcu(
    type="fmu",
    api=2,
    params=FmuParams,
    fault=LoopFault,
    begin=_begin,
    sends=sends,
    fits=fits,
    locate=_locate,
    step_ns=1_000_000,
)
