"""A monitor's kernel is tried before it is on a bus: ordinary, missing, random and extreme inputs, indices checked.

Its findings would switch the monitor off while it runs, or make results of no fault.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.monitors.authors import author_of
from gateway.monitors.conformance import checked_faults
from gateway.monitors.contract import (
    COUNTS_ITSELF,
    LEAST_SLEEP_NS,
    MAX_RESULTS,
    TIMER,
    WAKES_ITSELF,
    Monitor,
    MonitorParams,
)
from gateway_fdi.errors import InputError
from gateway_fdi.jit import run_entry

#: Steps with inputs of one kind, and time between two of them [ns].
STEPS, PERIOD_NS = 200, 10_000_000
#: How long all steps may take, before one of them is thought not to return [s].
PATIENCE_S = 30.0
_EXTREMES = (0.0, -0.0, 5e-324, 1e308, -1e308, np.inf, -np.inf, 2.0**31, -(2.0**31), 2.0**63, 1e16)


def _kinds(count: int, rng: np.random.Generator, *, numbers: bool) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield kinds of inputs, each of shape (STEPS, count); ``numbers``: none is missing or beyond what signals are."""
    shape = (STEPS, count)
    yield "zero", np.zeros(shape)
    yield "ordinary", 10.0 + np.sin(np.arange(STEPS) / 10.0)[:, None] * np.ones(shape)
    yield "random", rng.normal(size=shape) * 10.0 ** rng.uniform(-3.0, 6.0, shape)
    if numbers:
        return
    yield "missing (NaN)", np.full(shape, np.nan)
    some = rng.normal(size=shape) * 100.0
    some[rng.random(shape) < 0.3] = np.nan
    yield "partly missing", some
    yield "extreme", rng.choice(_EXTREMES, shape)


def try_out(monitor: Monitor[Any], params: MonitorParams, seed: int = 1) -> list[str]:
    """Step a monitor with inputs of all kinds; returns what is wrong with it, a line each.

    Args:
        monitor: from outside or not; its code has every index checked.
        params: its parameters.
        seed: of the random inputs.

    Raises:
        InputError: its kernel cannot be compiled, or its own code in plain Python fails.
    """
    address = monitor.checked_entry
    faults = checked_faults(monitor, params)
    found: list[str] = []
    doing = ["nothing"]
    failed: list[Exception] = []

    def work() -> None:
        rng = np.random.default_rng(seed)
        count = monitor.inputs.dtype.itemsize // 8 - 2
        try:
            for kind, values in _kinds(count, rng, numbers=monitor.gets_numbers):
                doing[0] = kind
                found.extend(dict.fromkeys(_steps(monitor, params, address, len(faults), kind, values)))
        except Exception as error:  # prepare() may fail the second time only
            failed.append(error)

    thread = threading.Thread(target=work, name="try-out", daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    if failed:
        raise failed[0]
    if thread.is_alive():
        found.append(f"with {doing[0]} inputs a step does not return within {PATIENCE_S:g} s")
    return found


def refuse_failing(monitor: Monitor[Any], params: MonitorParams) -> None:
    """Refuse a monitor with which something is wrong.

    Raises:
        InputError: the first that :func:`try_out` finds.
    """
    for text in try_out(monitor, params):
        raise InputError(text, file=monitor.file, key=f'monitor type "{monitor.type}".step')


def _records(monitor: Monitor[Any], params: MonitorParams) -> list[Any]:
    """Return fresh records as its kernel takes them, each of shape (1,)."""
    made = [np.zeros(1, dtype) for dtype in monitor.records]
    with author_of(monitor, "prepare"):
        monitor.prepare(params, made[0].view(np.recarray)[0], made[1].view(np.recarray)[0])
    return made


def _steps(
    monitor: Monitor[Any], params: MonitorParams, address: int, faults: int, kind: str, values: NDArray[np.float64]
) -> Iterator[str]:
    made = _records(monitor, params)
    u, out = made[2], made[3][0]
    cells = u.view(np.float64)
    for k, row in enumerate(values):
        t_ns, trigger = (k + 1) * PERIOD_NS, TIMER if k % 7 == 6 else 0
        u["t_ns"], u["trigger"] = t_ns, trigger
        cells[2:] = row
        out["n"] = out["overflow"] = out["wake_ns"] = out["send"] = 0
        why = run_entry(address, made)
        if why:
            shown = ", ".join(f"{value:g}" for value in row[:8])
            yield f"with {kind} inputs ({shown}) its step {k + 1} fails: {monitor.failure(made[0][0], why)}"
            return
        if not 0 <= int(out["n"]) <= MAX_RESULTS or int(out["overflow"]) < 0:
            yield f"with {kind} inputs {COUNTS_ITSELF}"
            return
        if trigger == TIMER and 0 < int(out["wake_ns"]) < t_ns + LEAST_SLEEP_NS:
            yield f"with {kind} inputs {WAKES_ITSELF}"
        numbers = out["results"]["fault"][: int(out["n"])]
        wrong = [int(number) for number in numbers if not 0 <= number < faults]
        if wrong:
            yield f"with {kind} inputs it reports fault number {wrong[0]}; its faults are 0 to {faults - 1}"
        if int(out["overflow"]):
            yield f"with {kind} inputs it reports {int(out['overflow'])} results too many in one step"
