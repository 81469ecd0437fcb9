"""The paper's Figs. 2 to 5, from its equations (1) to (8) and our data."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from gateway_plants.crank.study.paper import ALPHA, BETA, PULSES, deviation, fault_signal, paper_run
from gateway_replay.drawing import save


def _fig2(folder: Path) -> Path:
    figure, axes = plt.subplots(2, 2, figsize=(8, 4.5), sharex=True, sharey=True)
    for axis, count in zip(axes.T.ravel(), (1, 2, -1, -2), strict=True):
        f = fault_signal(count, PULSES + 6, 1)[PULSES - 5 :]
        at = np.arange(len(f)) - 5
        axis.stem(at, f, basefmt="k-")
        word = "missed" if count > 0 else "added"
        axis.set_title(f"{abs(count)} pulse{'s' if abs(count) > 1 else ''} {word}", fontsize=10)
        axis.set_xticks(at)
        axis.grid(alpha=0.3)
    for axis in axes[:, 0]:
        axis.set_ylabel(r"$f_k\,/\,(\beta-\alpha)$")
    for axis in axes[1]:
        axis.set_xlabel(r"$k - n\Pi$")
    figure.suptitle("Fig. 2  Shape of the fault signals", fontsize=11)
    return save(figure, folder / "fig2-fault-signals.png")


def _fig345(folder: Path, number: int, count: int, title: str, seed: int) -> Path:
    y, r = paper_run(count, seed)
    figure, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True)
    axes[0].plot(y, "k-", linewidth=1)
    axes[0].set_ylabel("pulse time PT")
    axes[1].plot(r, "k-", linewidth=1)
    sigma = deviation()
    for level, style, text in (
        (1.0, ":", "1.0, as printed"),
        ((BETA - ALPHA) / 2, "--", r"$\delta/2$, repaired"),
    ):
        axes[1].axhline(level, color="C3", linestyle=style, linewidth=1, label=text)
        axes[1].axhline(-level, color="C3", linestyle=style, linewidth=1)
    axes[1].axhspan(-sigma, sigma, color="C0", alpha=0.15, label=r"$\pm\sigma_r$ by (13)")
    axes[1].set_ylabel("residual $r_k$")
    axes[1].set_xlabel("pulse k")
    axes[1].set_ylim(-9, 8)
    axes[1].legend(loc="lower left", fontsize=8, ncols=3)
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.suptitle(
        f"Fig. {number}  {title}{'' if count == 0 else '; not corrected'}  (seed {seed})",
        fontsize=11,
    )
    return save(figure, folder / f"fig{number}-{title.split(', ')[1].replace(' ', '-')}.png")


def draw(folder: Path, seed: int) -> list[Path]:
    """Draw Figs. 2 to 5 into a folder; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    return [
        _fig2(folder),
        _fig345(folder, 3, 0, "Residuals, no fault", seed),
        _fig345(folder, 4, 1, "Residuals, one pulse missed", seed),
        _fig345(folder, 5, -1, "Residuals, one pulse added", seed),
    ]
