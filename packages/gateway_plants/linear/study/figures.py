"""Pictures of the study: the paper's Figs. 3 to 11, its flags beside ours, and the hold-out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from gateway_plants.linear.study import example
from gateway_plants.linear.study.bank import run
from gateway_plants.linear.study.continuous import observe
from gateway_plants.linear.study.holdout import KINDS, Row
from gateway_replay.drawing import save

#: The paper draws its flags this high.
_ACTUATOR, _SENSOR = 0.08, 0.3


def _estimates(axis: Any, t: Any, told: Any, i: int) -> None:
    for k in range(3):
        axis.plot(t, told.omega[:, k, i], lw=1.0, label=f"$\\omega_{{{k + 1}{i + 1}}}$")
    axis.step(t, _ACTUATOR * told.actuators[:, i], "k", lw=1.2, where="post", label=f"$r_{{a{i + 1}}}$")
    axis.set_ylim(-0.15, 0.15)
    axis.set_ylabel(f"actuator {i + 1} [rad]")


def _left(axis: Any, t: Any, told: Any) -> None:
    for j in range(3):
        others = [k for k in range(3) if k != j]
        least = np.abs(told.e[:, others, j]).min(axis=1)
        axis.plot(t, least, lw=1.0, label=f"least $|e_{{k{j + 1}}}|$")
        if told.sensors[:, j].any():
            axis.step(
                t,
                _SENSOR * told.sensors[:, j],
                "k",
                lw=1.2,
                where="post",
                label=f"$r_{{s{j + 1}}}$",
            )
    axis.axhline(example.SENSOR_LIMIT, color="grey", lw=0.6, ls=":")
    axis.set_ylim(0, 0.55)
    axis.set_ylabel("sensors")


def _ours(axis: Any, t: Any, found: Any) -> None:
    flags = np.hstack([found.actuators, found.sensors])
    for row in range(5):
        axis.fill_between(t, row, row + 0.8 * flags[:, row], step="post", color=f"C{row}")
    axis.set_yticks(np.arange(5) + 0.4, ("a1", "a2", "s1", "s2", "s3"))
    axis.set_ylim(0, 5)
    axis.set_ylabel("ours")


def _cases(path: Path, names: tuple[str, ...]) -> Path:
    figure, axes = plt.subplots(4, len(names), figsize=(3.4 * len(names), 8.5), sharex=True, squeeze=False)
    for column, name in enumerate(names):
        faults = example.case(*example.FIGURES[name])
        told = observe(*example.held(faults))
        t = np.arange(len(told.omega)) * example.PERIOD
        for i in range(2):
            _estimates(axes[i, column], t, told, i)
        _left(axes[2, column], t, told)
        _ours(axes[3, column], t, run(faults, 0.0, np.random.default_rng(0)))
        axes[0, column].set_title(f"{name}: {', '.join(example.FIGURES[name])}")
        axes[3, column].set_xlabel("t [s]")
    for row in range(3):
        axes[row, 0].legend(fontsize=7, loc="lower left" if row < 2 else "upper left")
        axes[row, -1].legend(fontsize=7, loc="lower left" if row < 2 else "upper left")
    return save(figure, path)


def _bars(path: Path, rows: list[Row]) -> Path:
    methods = list(dict.fromkeys(row.method for row in rows))
    figure, axis = plt.subplots(figsize=(8, 3.6))
    width = 0.8 / len(methods)
    for place, method in enumerate(methods):
        shares = [100 * next(r.clean for r in rows if (r.method, r.case) == (method, kind)) for kind in KINDS]
        bars = axis.bar(np.arange(3) + place * width, shares, width, label=method)
        axis.bar_label(bars, fmt="%.0f", fontsize=8)
    axis.set_xticks(np.arange(3) + 0.4 - width / 2, [f"{kind} at fault" for kind in KINDS])
    axis.set_ylabel("clean cases [%]")
    axis.set_ylim(0, 112)
    axis.legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return save(figure, path)


def draw(folder: Path, rows: list[Row]) -> list[Path]:
    """Draw everything into a folder; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    names = tuple(example.FIGURES)
    files = [
        _cases(folder / "fig3_to_7.png", names[:5]),
        _cases(folder / "fig8_to_11.png", names[5:]),
    ]
    return [*files, _bars(folder / "holdout.png", rows)] if rows else files
