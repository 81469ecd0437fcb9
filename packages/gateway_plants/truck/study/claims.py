"""What a reader of paper 004, V and VI, looks for, beside what comes out here (II to IV: docs/structure.md)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway_bench.cli.study import Claim, claim
from gateway_fdi.detectors import StoppingRule
from gateway_plants.truck.ecu.params import TruckFault
from gateway_plants.truck.monitor.params import Params
from gateway_plants.truck.study import paper
from gateway_plants.truck.study.conditions import CONDITIONS, Compared
from gateway_plants.truck.study.follow import inputs
from gateway_plants.truck.study.paper import RESIDUALS, T4_ABSOLUTE, T4_MIXED, T4_SIGNED, Paper, Trace
from gateway_plants.truck.study.table import FAULTS, TRUCK, Row

#: Fig. 4: f, J and the magnitude of y from which on T is updated; nu and the step [s] are not printed.
FAULT, LEVEL, EXCITED, NU, STEP = 0.3, 200.0, 6.0, 2.0, 0.01
#: Fig. 7: when the model holds [s].
_LONG_WINDOW = (1594.0, 1677.0)


def example() -> tuple[float, float, float]:
    """Return Fig. 4: the largest T if it is always updated, and if only while |y| > 6, and when that passes J [s].

    (27) to (30): r = y - u = f u, u = 10 sin t, over 60 s; T by (26).
    """
    u = 10.0 * np.sin(np.arange(0.0, 60.0, STEP))
    residual, excited = np.abs(FAULT * u), np.abs((1.0 + FAULT) * u) > EXCITED
    always = StoppingRule("cusum", np.inf, drift=NU).levels(residual)
    sums = StoppingRule("cusum", np.inf, drift=NU).levels(residual[excited])
    first = np.flatnonzero(excited)[np.flatnonzero(sums > LEVEL)[0]] if sums.max() > LEVEL else np.inf
    return float(always.max()), float(sums.max()), float(first * STEP)


def healthy_and_not(seed: int) -> tuple[Trace, Trace]:
    """Return the drives of Fig. 7: without a fault, and with half of the machine's efficiency from the start."""
    faults = (None, TruckFault(kind="machine_efficiency", from_s=0.0))
    healthy, faulty = (paper.follow(inputs(TRUCK, fault, seed), Paper(), keep=True).trace for fault in faults)
    return healthy, faulty


def blanked(trace: Trace, name: str) -> NDArray[np.float64]:
    """Return a residual, not a number where the model does not hold."""
    return np.where(trace.valid, trace.residual[:, RESIDUALS.index(name)], np.nan)


def battery_short(seed: int) -> tuple[Trace, NDArray[np.float64]]:
    """Return the drive of Fig. 8, a short circuit from 400 s on, and T_norm of T4: ICDS, MCDS; shape (n, 2).

    ICDS has the larger one of (41) and (45); no T is limited.
    """
    unlimited = Paper(monitor=Params(follow=False, limit=1e12))
    params = paper.calibrated(unlimited, [inputs(TRUCK, None, seed + 1)], floor=1.0)
    fault = TruckFault(kind="battery_short", from_s=400.0)
    trace = paper.follow(inputs(TRUCK, fault, seed), params, keep=True).trace
    norm = trace.norm
    return trace, np.column_stack([np.maximum(norm[:, T4_SIGNED], norm[:, T4_ABSOLUTE]), norm[:, T4_MIXED]])


def claims(sensor: Compared, efficiency: Compared, fired: Sequence[Row], seed: int) -> list[Claim]:
    """Return what the paper has, and what comes out here.

    Args:
        sensor: conditions with the voltage sensor 20 V off from the start.
        efficiency: conditions with half of the machine's efficiency.
        fired: which system isolates which fault.
        seed: of the noise of the other drives.
    """
    always, conditioned, first = example()
    found = [
        claim(
            f"Fig. 4, (29), (30): f = {FAULT:g}, J = {LEVEL:g}",
            "T updated always: no reaction; while |y| > 6: reaction",
            f"always T <= {always:.0f}; |y| > 6: above J after {first:.1f} s (nu {NU:g}, steps of {1e3 * STEP:.0f} ms)",
            always < LEVEL < conditioned,
        )
    ]

    def shown(values: Iterable[float]) -> str:
        return ", ".join(f"{name} {value:.2f}" for name, value in zip(CONDITIONS, values, strict=True))

    def rounded(values: Iterable[float]) -> str:
        """Return levels to three digits."""
        return ", ".join(f"{float(f'{value:.3g}'):g}" for value in values)

    down, on, norm = sensor.down, sensor.on, sensor.norm.max(axis=0)
    found.append(claim("Fig. 5: voltage sensor; T falls / rises", "(41) falls less than (39)", shown(down),
                       down[1] < down[0]))  # fmt: skip
    best, names = efficiency.norm.max(axis=0), ", ".join(CONDITIONS)
    found.append(claim(f"Fig. 6: efficiency; largest T_norm of {names}", "(45) above (41) and (39)", rounded(best),
                       best[2] > max(best[0], best[1]), "(39) grows from the first sample on"))  # fmt: skip
    here = f"T_norm: sensor {rounded(norm[1:3])}; efficiency {rounded(best[1:3])}"
    found.append(claim("Remark 4: (41) for the sensor, (45) for the efficiency", "two quantities of one residual",
                       here, norm[1] > norm[2] and best[2] > best[1]))  # fmt: skip
    quiet, faulty = healthy_and_not(seed)
    at = (quiet.t >= _LONG_WINDOW[0]) & (quiet.t < _LONG_WINDOW[1])
    sizes = [
        float(np.nanmean(np.abs(blanked(faulty, name)[at])) / np.nanstd(blanked(quiet, name)))
        for name in ("T3_ICDS", "T3_MCDS")
    ]
    found.append(claim("Fig. 7: T3 with half the efficiency, mean |r| in deviations", "ICDS more than MCDS",
                       f"{sizes[0]:.1f}, {sizes[1]:.1f}", sizes[0] > sizes[1]))  # fmt: skip
    short = battery_short(seed)[1].max(axis=0)
    found.append(claim("Fig. 8: T4, battery short at 400 s, T_norm", "ICDS more than MCDS",
                       rounded(short), bool(short[0] > short[1])))  # fmt: skip
    found.append(claim("Fig. 9: voltage sensor; T_norm above 1 behind the first alarm", "(41) alone, to the end",
                       shown(on), on[1] > 0.95 > max(on[0], on[2], on[3]), "see the shares"))  # fmt: skip
    for system in paper.TESTS:
        rows = [row for row in fired if row.system == system and row.fault is not None]
        right, runs = sum(row.right for row in rows), sum(row.runs for row in rows)
        if runs:
            found.append(claim(f"VI-E: {system} isolates all {len(FAULTS)} faults", "all", f"{right} of {runs} runs",
                               right == runs, "a fault that begins late is not excited any more"))  # fmt: skip
    return found
