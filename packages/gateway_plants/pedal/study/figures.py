"""The paper's Figs. 9 to 14 from our data (paper 002, section IV)."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from gateway_plants.pedal.study.cases import IDEAL, NOISY, Case, Environment, Run, make
from gateway_plants.pedal.study.follow import VOTERS, follow
from gateway_plants.pedal.study.table import RATES, SWEEP, VALUES, Score
from gateway_replay.drawing import save

#: What the text quotes: (fault rate or value [%], IAE).
PAPER_RATE = {"average": (15, 33.897), "median": (15, 8.524), "KHR": (15, 1.898)}
PAPER_VALUE = {"average": (15, 33.402), "median": (15, 4.338), "KHR": (15, 1.226)}
COLOURS = dict(zip(VOTERS, ("C7", "C8", "C1", "C4", "C3", "C6", "C0", "C2"), strict=True))
NAMES = {"KHR": "KHR as printed", "KHR*": "KHR*, repaired", "tracking": "tracking (ours)"}


def _panel(left: Axes, right: Axes, run: Run, environment: Environment, voters: tuple[str, ...]) -> None:
    """Draw the readings of a run and what voters make of them, and beside it their errors."""
    t = np.arange(len(run.truth))
    for channel, colour in ((0, "0.75"), (1, "0.6")):
        left.plot(t, run.readings[:, channel], color=colour, linewidth=0.6)
    left.plot(t, run.truth, "k:", linewidth=1.2, label="pedal")
    for voter in voters:
        value = follow(voter, environment, run).value
        error = np.abs(value - run.truth)
        left.plot(t, value, color=COLOURS[voter], linewidth=1.3, label=NAMES[voter])
        label = f"{NAMES[voter]}: IAE {error.sum():.3g}"
        shown = np.maximum(error, 1e-6)
        right.plot(t, shown, color=COLOURS[voter], linewidth=0.8, label=label)
    left.set_ylim(-0.2, 5.2)
    left.set_ylabel("V")
    left.legend(loc="lower center", fontsize=8)
    right.set_yscale("log")
    right.set_ylim(1e-6, 10)
    right.set_ylabel("|error| [V]")
    right.legend(loc="upper left", fontsize=8)
    for axis in (left, right):
        axis.grid(alpha=0.3)


def _runs(folder: Path, name: str, title: str, panels: list[tuple[Case, Environment, str]], seed: int) -> Path:
    """Draw runs, a row each."""
    figure, axes = plt.subplots(len(panels), 2, figsize=(11, 3 * len(panels) + 0.5), sharex=True, squeeze=False)
    for (left, right), (case, environment, text) in zip(axes, panels, strict=True):
        voters = ("KHR", "KHR*", "tracking")
        _panel(left, right, make(case, environment, seed), environment, voters)
        left.set_title(f"{environment.name}: {text}", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("time [ms]")
    figure.suptitle(f"{title} (seed {seed})", fontsize=11)
    return save(figure, folder / name)


def _fig9(folder: Path, seed: int) -> Path:
    text = "one channel clean, the other with impulses"
    case = Case("clean + impulses")
    return _runs(
        folder,
        "fig9-impulses.png",
        "Fig. 9  Transient and intermittent faults",
        [(case, IDEAL, text), (case, NOISY, text)],
        seed,
    )


def _fig10(folder: Path, seed: int) -> Path:
    return _runs(
        folder,
        "fig10-permanent.png",
        "Fig. 10  A permanent and an intermittent fault together",
        [
            (Case("dead", onset=onset), environment, f"0 V from {onset} ms on, and impulses")
            for environment, onset in ((IDEAL, 650), (IDEAL, 300), (NOISY, 650))
        ],
        seed,
    )


def _sweep(
    folder: Path,
    number: int,
    scores: list[Score],
    cases: tuple[Case, ...],
    voters: tuple[str, ...],
    paper: dict[str, tuple[int, float]],
    label: str,
) -> Path:
    environments = ("ideal", "10 bit", "2 mV + 12 bit")
    figure, axes = plt.subplots(1, 3, figsize=(11, 4.4), sharey=True)
    by = {(s.environment, s.case, s.voter): s for s in scores if s.stroke == "exponential"}
    x = [round(100 * k) for k in SWEEP]
    for axis, environment in zip(axes, environments, strict=True):
        for voter in voters:
            rows = [by[environment, str(case), voter] for case in cases]
            mean = np.array([row.iae for row in rows])
            error = np.array([row.sd / row.runs**0.5 for row in rows])
            name = NAMES.get(voter, voter)
            axis.plot(x, mean, "o-", color=COLOURS[voter], markersize=3, label=name)
            axis.fill_between(x, mean - error, mean + error, color=COLOURS[voter], alpha=0.2)
            if voter in paper:
                axis.plot(*paper[voter], "x", color=COLOURS[voter], markersize=9, mew=2)
        axis.set_title(environment, fontsize=10)
        axis.set_xlabel(label)
        axis.set_yscale("log")
        axis.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("IAE [V x sample], mean")
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=9, loc="lower center", ncols=4)
    crosses = "; crosses: the paper's numbers" if paper else ""
    runs = next(iter(by.values())).runs
    figure.suptitle(f"Fig. {number}  {runs} runs a point{crosses}", fontsize=11)
    kind = "rate" if cases is RATES else "value"
    against = "-predictive" if "predictive" in voters else ""
    return save(figure, folder / f"fig{number}-{kind}{against}.png")


def draw(folder: Path, scores: list[Score], seed: int) -> list[Path]:
    """Draw the figures into a folder; returns the files.

    Args:
        folder: made if need be.
        scores: of both sweeps in the three environments; without them Figs. 11 to 14 are left out.
        seed: of the runs of Figs. 9 and 10.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [_fig9(folder, seed), _fig10(folder, seed)]
    if scores:
        simple = ("average", "median", "KHR", "tracking")
        hybrid = ("predictive", "KHR", "KHR*", "tracking")
        rate, value = "fault rate [%], value 10 %", "fault value [%], rate 10 %"
        files += [
            _sweep(folder, 11, scores, RATES, simple, PAPER_RATE, rate),
            _sweep(folder, 12, scores, VALUES, simple, PAPER_VALUE, value),
            _sweep(folder, 13, scores, RATES, hybrid, {}, rate),
            _sweep(folder, 14, scores, VALUES, hybrid, {}, value),
        ]
    return files
