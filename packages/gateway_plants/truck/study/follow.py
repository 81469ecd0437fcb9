"""A drive through the monitor itself: the same kernel as on the bus, fed with what the bus would carry."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.monitors.contract import FAILED
from gateway.signals.frame_encoding import carried
from gateway_bench.vecu.databases import message_of
from gateway_fdi.cusum import FLOOR, MARGIN, nus, threshold
from gateway_fdi.jit import kernel, zeros
from gateway_fdi.linear_algebra import copy
from gateway_plants.truck.ecu.control import PERIOD
from gateway_plants.truck.ecu.drive import Drive, drive
from gateway_plants.truck.ecu.ecu import DATABASE, signals_of
from gateway_plants.truck.ecu.params import TruckFault, TruckParams
from gateway_plants.truck.monitor import MONITOR, monitor, observer
from gateway_plants.truck.monitor.messages import MESSAGES, signal_of
from gateway_plants.truck.monitor.observer import ERRORS
from gateway_plants.truck.monitor.params import QUANTITIES, Params, Thresholds
from gateway_plants.truck.monitor.records import RESIDUALS

Array = NDArray[np.float64]

#: FTP75 without its soak [s].
DURATION = 1874.0


@lru_cache(maxsize=4)
def _driven(truck: TruckParams, fault: TruckFault | None) -> Drive:
    return drive(truck, () if fault is None else (fault,), DURATION)


@lru_cache(maxsize=2)
def inputs(truck: TruckParams, fault: TruckFault | None, seed: int) -> NDArray[np.void]:
    """Return the monitor's inputs on FTP75 as the database carries them, shape (sets,).

    Args:
        truck: with its disturbances.
        fault: that it has, if any.
        seed: of the sensors' noise.
    """
    driven = _driven(truck, fault)
    columns = signals_of(truck, driven, np.random.default_rng(seed))
    u: NDArray[np.void] = zeros(len(driven.samples), MONITOR.inputs)
    u["t_ns"] = np.rint(np.arange(len(u)) * PERIOD * 1e9).astype(np.int64)
    u["gap"] = 1.0
    for name, fields in MESSAGES.items():
        mine = {signal_of(field): columns[signal_of(field)] for field in fields}
        decoded = carried(message_of(DATABASE, name), mine)
        for field in fields:
            u[field] = decoded[signal_of(field)]
    return u


@dataclass(frozen=True)
class Followed:
    """What the monitor made of a drive; n sets.

    Attributes:
        first: second in which each fault was first reported, infinite if never, shape (faults,).
        peak: largest T_norm of each quantity, and of T7, shape (quantities + 1,).
        trace: None, or the rest, set by set.
    """

    first: Array
    peak: Array
    trace: Trace | None


@dataclass(frozen=True)
class Trace:
    """Set by set.

    Attributes:
        t: time [s], shape (n,).
        valid: the model holds, shape (n,).
        residual: shape (n, 5), of T1, T2, T5 to T7, which keeps its last value while it does not run.
        norm: T_norm, shape (n, quantities).
        wald: T7 over its threshold, shape (n,).
        error: what T7's observer estimates, shape (n, 7).
    """

    t: Array
    valid: NDArray[np.bool_]
    residual: Array
    norm: Array
    wald: Array
    error: Array


@kernel
def _walk(s: Any, c: Any, u: Any, out: Any, first: Any, valid: Any, rows: Any) -> None:
    """Step the monitor through all sets; ``rows`` of no length: nothing is kept."""
    for k in range(u.shape[0]):
        out.n = 0
        monitor.step(s, c, u[k], out)
        for j in range(out.n):
            r = out.results[j]
            if r.result == FAILED and first[r.fault] < 0:
                first[r.fault] = k
        if rows.shape[0] == 0:
            continue
        valid[k] = s.valid == 1
        at = len(s.residual) + len(s.norm)
        copy(rows[k], s.residual, len(s.residual))
        copy(rows[k, len(s.residual) :], s.norm, len(s.norm))
        rows[k, at] = s.observer.norm
        copy(rows[k, at + 1 :], s.observer.error, ERRORS)


def _run(u: NDArray[np.void], params: Params, keep: bool) -> tuple[Any, Array, Any, Any]:
    s, c, out = (zeros(1, dtype) for dtype in (MONITOR.state, MONITOR.const, MONITOR.results))
    MONITOR.prepare(params, s[0], c[0])
    first = np.full(len(MONITOR.faults(params)), -1, np.int64)
    length = len(u) if keep else 0
    valid = np.zeros(length, np.bool_)
    rows = np.empty((length, RESIDUALS + len(QUANTITIES) + ERRORS + 1))
    _walk(s[0], c[0], u, out[0], first, valid, rows)
    return s[0], np.where(first < 0, np.inf, first * PERIOD), valid, rows


def follow(u: NDArray[np.void], params: Params, *, keep: bool = False) -> Followed:
    """Put a drive through the monitor; ``keep`` its trace."""
    s, first, valid, rows = _run(u, params, keep)
    peak = np.append(s["cusum"]["peak"], s["observer"]["peak"])
    if not keep:
        return Followed(first, peak, None)
    a, b = RESIDUALS, RESIDUALS + len(QUANTITIES)
    trace = Trace(
        t=np.asarray(np.arange(len(u)) * PERIOD, np.float64),
        valid=valid,
        residual=rows[:, :a],
        norm=rows[:, a:b],
        wald=rows[:, b],
        error=rows[:, b + 1 :],
    )
    return Followed(first, peak, trace)


def calibrated(params: Params, healthy: list[NDArray[np.void]]) -> Params:
    """Return parameters with nu and J from healthy drives, as ``gateway calibrate`` finds them."""
    states = [_run(u, params, keep=False)[0]["cusum"].copy() for u in healthy]
    sums = np.sum([[s[key] for key in ("samples", "total", "squares")] for s in states], axis=0)
    nu, names = nus(QUANTITIES, sums), [*QUANTITIES, "T7"]
    never = Thresholds(**dict.fromkeys(names, 1e9))
    opened = params.model_copy(update={"nu": params.nu.model_copy(update=nu), "thresholds": never})
    peaks = np.max([follow(u, opened).peak for u in healthy], axis=0) * 1e9
    found = {
        name: threshold(peak, MARGIN, observer.FLOOR if name == "T7" else FLOOR)
        for name, peak in zip(names, peaks, strict=True)
    }
    return opened.model_copy(update={"thresholds": Thresholds(**found)})
