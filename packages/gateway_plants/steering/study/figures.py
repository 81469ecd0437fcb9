"""The paper's Figs. 4 to 7 from our data, and what the monitor makes of faults (paper 001)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from gateway_plants.steering.study.estimators import (
    ANCHORED,
    EKF3,
    EKF4_DQ,
    EKF5_AB,
    FF_HELD,
    LO,
    NAMES,
    REDUCED,
    estimate,
    nominal,
)
from gateway_plants.steering.study.table import CASES, KNOWN, UNKNOWN, Score
from gateway_replay.drawing import save

Array = NDArray[np.float64]

#: The paper's colours and lines: Luenberger red dotted, reduced magenta, EKF black dash-dotted, feed-forward green.
_PAPER = (
    (LO, "r", ":"),
    (REDUCED, "m", "-"),
    (EKF3, "k", "-."),
    (FF_HELD, "g", "--"),
)
_OURS = ((EKF4_DQ, "C1", "-"), (EKF5_AB, "C0", "-"), (ANCHORED, "C9", "-"))
#: Figure, from [s], to [s], what it shows.
_PARTS = (
    (4, 0.0, 8.0, "12 rad at 0.5 Hz, then a rest under load"),
    (5, 8.0, 24.0, "20 rad at 0.7 Hz, rest under load, creep, chirp"),
    (6, 9.0, 11.0, "zoom of Fig. 5 at higher speed"),
    (7, 12.0, 14.0, "zoom of Fig. 5 at standstill: 0.6 Nm from 12.3 to 13.3 s"),
)


def _part(folder: Path, number: int, begin: float, end: float, text: str, t: Array, x: Any, est: Array) -> Path:
    inside = (t >= begin) & (t < end)
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.6))
    left.plot(t[inside], x["sensor"][inside], "b-", linewidth=1.5, label="measured")
    start = inside.argmax()
    for at, colour, line in (*_PAPER, *(_OURS if number == 7 else _OURS[2:])):
        # Each starts from the measured angle: what it adds in this part is to be seen.
        angle = est[:, at] - est[start, at] + x["theta"][start]
        left.plot(t[inside], angle[inside], line, color=colour, linewidth=1.1, label=NAMES[at])
        error = np.degrees(angle - x["theta"])
        right.plot(t[inside], error[inside], line, color=colour, linewidth=1.1, label=NAMES[at])
    left.set_ylabel("motor angle [rad]")
    right.set_ylabel("error [deg, mechanical]")
    if number in (5, 7):
        right.set_yscale("symlog", linthresh=10)
    for axis in (left, right):
        axis.set_xlabel("time [s]")
        axis.grid(alpha=0.3)
    figure.legend(*left.get_legend_handles_labels(), loc="lower center", ncols=8, fontsize=7)
    figure.suptitle(f"Fig. {number}  {text}; each estimate begins at the measured angle", fontsize=11)
    return save(figure, folder / f"fig{number}.png")


def _delays(folder: Path, scores: list[Score]) -> Path:
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5), width_ratios=(1, 1.2))
    mine = {s.case: s for s in scores if s.temperature == UNKNOWN and s.period_ms == 1.0}
    motor = [case for case in CASES if np.isfinite(case.note_ms) and case.name in mine]
    y = np.arange(len(motor))
    for k, case in enumerate(motor):
        s = mine[case.name]
        left.plot([s.delay_ms, s.delay_max_ms], [k, k], "C0-", linewidth=5, alpha=0.4)
        left.plot(s.delay_ms, k, "C0o")
        left.text(
            s.delay_max_ms * 1.15,
            k,
            f"{100 * s.detected:.0f} %",
            va="center",
            fontsize=8,
            color="C0",
        )
        left.plot(case.note_ms, k + 0.25, "kx")
    left.set_yticks(y, [case.name for case in motor])
    left.set_xscale("log")
    left.set_xlim(3, 8000)
    left.invert_yaxis()
    left.set_xlabel("delay of the detection [ms]")
    left.set_title(
        "dot: mean, bar: to the longest; x: best single rules of the\nprototype, mean of those detected",
        fontsize=9,
    )
    left.grid(alpha=0.3)
    for shift, temperature in ((-0.2, UNKNOWN), (0.2, KNOWN)):
        by = {s.case: s for s in scores if s.temperature == temperature and s.period_ms == 1.0}
        names = [case.name for case in CASES if case.name in by]
        right.barh(
            np.arange(len(names)) + shift,
            [100 * np.nan_to_num(by[name].isolated) for name in names],
            0.38,
            label=f"resistance {temperature}",
        )
        right.set_yticks(np.arange(len(names)), names)
    right.invert_yaxis()
    right.set_xlabel("sensor isolated, of the runs in which it was detected [%]")
    right.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    right.grid(alpha=0.3, axis="x")
    return save(figure, folder / "detection.png")


def draw(folder: Path, scores: list[Score], seed: int) -> list[Path]:
    """Draw the figures into a folder; returns the files.

    Args:
        folder: made if need be.
        scores: of the faults; without them their figure is left out.
        seed: of the run of Figs. 4 to 7.
    """
    folder.mkdir(parents=True, exist_ok=True)
    x = nominal(seed, 1e-3)
    est = estimate(x, 1e-3, mean_dq=True)
    t: Array = np.arange(1, len(x) + 1, dtype=np.float64) * 1e-3
    files = [_part(folder, *part, t, x, est) for part in _PARTS]
    if scores:
        files.append(_delays(folder, scores))
    return files
