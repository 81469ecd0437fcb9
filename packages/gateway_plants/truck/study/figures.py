"""Pictures of the study: Figs. 5 to 9 of paper 004 from our truck, and what T7's observer estimates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from gateway_plants.truck.ecu.params import TruckFault
from gateway_plants.truck.monitor.observer import ENGINE, GENERATOR, MASS, MOTOR, SLOPE
from gateway_plants.truck.monitor.params import Params
from gateway_plants.truck.study import paper
from gateway_plants.truck.study.claims import battery_short, blanked, healthy_and_not
from gateway_plants.truck.study.conditions import CONDITIONS, NOISE, Compared
from gateway_plants.truck.study.follow import Trace, follow, inputs
from gateway_plants.truck.study.table import TRUCK
from gateway_replay.drawing import save

#: Parts of the cycle that the figures show [s].
_TWO_WINDOWS, _LONG_WINDOW = (440.0, 620.0), (1560.0, 1700.0)
#: One sample in so many is drawn.
_THIN = 20


def _shade(axis: Any, trace: Trace | paper.Trace) -> None:
    """Shade where the model holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], trace.valid, [False]]).astype(int)))
    for first, last in edges.reshape(-1, 2):
        axis.axvspan(trace.t[first], trace.t[last - 1], color="0.9", lw=0)


def _between(trace: paper.Trace, span: tuple[float, float]) -> NDArray[np.int64]:
    return np.flatnonzero((trace.t >= span[0]) & (trace.t < span[1]))


def _mean(values: Any, count: int) -> Any:
    """Return the mean over so many samples, of those that are numbers; none where the value is none."""
    known = np.isfinite(values)
    ones = np.ones(count)
    total = np.convolve(np.where(known, values, 0.0), ones, "same")
    return np.where(known, total / np.maximum(np.convolve(known, ones, "same"), 1.0), np.nan)


def _two_windows(path: Path, compared: Compared, title: str, shown: tuple[str, ...]) -> Path:
    trace = compared.trace
    at = _between(trace, _TWO_WINDOWS)
    figure, axes = plt.subplots(3, 1, figsize=(9, 7.5), sharex=True)
    residual = blanked(trace, "T4_ICDS")
    axes[0].plot(trace.t[at], residual[at], lw=0.4, color="0.6", label="r")
    axes[0].plot(trace.t[at], _mean(residual[at], 100), lw=1.0, color="C0", label="mean of 1 s")
    axes[0].set_ylabel("residual of T4 [rad/s]")
    for k, name in enumerate(CONDITIONS):
        if name in shown:
            axes[1].plot(trace.t[at], compared.norm[at, k], lw=1.2, label=name, color=f"C{k}")
    axes[1].axhline(1.0, color="k", lw=0.6, ls=":")
    axes[1].set_ylabel("$T_{norm}$")
    current = np.where(trace.settled[at], trace.current[at], np.nan)
    axes[2].plot(trace.t[at], _mean(current, 20), lw=0.6)
    axes[2].set_ylabel("$I_{em}$ as T4 has it [A]")
    axes[2].set_xlabel("t [s]")
    for axis in axes:
        _shade(axis, trace)
        axis.set_xlim(*_TWO_WINDOWS)
    for axis in axes[:2]:
        axis.legend(fontsize=8, loc="upper left")
    axes[0].set_title(title, fontsize=10)
    return save(figure, path)


def _fig7(path: Path, seed: int) -> Path:
    healthy, faulty = healthy_and_not(seed)
    figure, axes = plt.subplots(2, 1, figsize=(9, 6), sharex=True)
    at = _between(healthy, _LONG_WINDOW)
    for axis, name in zip(axes, ("T3_ICDS", "T3_MCDS"), strict=True):
        sigma = np.nanstd(blanked(healthy, name))
        for trace, label, color in ((faulty, "$f_{em,\\eta}$", "C3"), (healthy, "no fault", "C0")):
            axis.plot(trace.t[at], blanked(trace, name)[at] / sigma, lw=0.5, label=label, color=color)
        _shade(axis, healthy)
        axis.set_ylabel(f"{name.replace('_', ' in ')}, normalised")
        axis.set_xlim(*_LONG_WINDOW)
        axis.legend(fontsize=8, loc="lower left")
    axes[0].set_title("Fig. 7: residuals of T3, standard deviation 1 without a fault", fontsize=10)
    axes[1].set_xlabel("t [s]")
    return save(figure, path)


def _fig8(path: Path, seed: int) -> Path:
    trace, norm = battery_short(seed)
    figure, axis = plt.subplots(figsize=(9, 4))
    axis.plot(trace.t[::_THIN], norm[::_THIN, 0], label="T4 in ICDS: the larger of (41) and (45)", color="C0")
    axis.plot(trace.t[::_THIN], norm[::_THIN, 1], label="T4 in MCDS", color="C1")
    _shade(axis, trace)
    axis.axvline(400.0, color="k", lw=0.6, ls="--")
    axis.axhline(1.0, color="k", lw=0.6, ls=":")
    axis.set_yscale("symlog", linthresh=1.0)
    axis.set_ylim(0)
    axis.set_xlim(0, trace.t[-1])
    axis.set_xlabel("t [s]")
    axis.set_ylabel("$T_{norm}$")
    axis.set_title("Fig. 8: short circuit in the battery from 400 s on", fontsize=10)
    axis.legend(fontsize=8, loc="lower right")
    return save(figure, path)


def _fig9(path: Path, compared: Compared) -> Path:
    trace = compared.trace
    figure, axis = plt.subplots(figsize=(9, 4))
    for k, (name, on) in enumerate(zip(CONDITIONS, compared.on, strict=True)):
        label = f"{name}, above 1 for {100 * on:.0f} % behind its first alarm"
        axis.plot(trace.t[::_THIN], compared.norm[::_THIN, k], lw=1.0, label=label, color=f"C{k}")
    _shade(axis, trace)
    axis.axhline(1.0, color="k", lw=0.6, ls=":")
    axis.set_xlim(0, trace.t[-1])
    axis.set_ylim(0, 1.6 * float(compared.norm.max()))
    axis.set_xlabel("t [s]")
    axis.set_ylabel("$T_{norm}$")
    axis.set_title(
        f"Fig. 9: T4 in ICDS, voltage sensor 20 V off from 0 s on, noise {NOISE:g} times",
        fontsize=10,
    )
    axis.legend(fontsize=8, loc="upper left")
    return save(figure, path)


def _estimates(path: Path, seed: int) -> Path:
    truck = TRUCK.model_copy(update={"slope": 0.003, "mass": 1.02, "engine": 1.02})
    fault = TruckFault(kind="machine_efficiency", from_s=400.0)
    trace = follow(inputs(truck, fault, seed), Params(), keep=True).trace
    assert trace is not None
    figure, axes = plt.subplots(3, 1, figsize=(9, 7.5), sharex=True)
    t = trace.t[::_THIN]
    rows = (
        (0, MOTOR, "machine as motor, -0.5 from 400 s on", -0.5),
        (0, GENERATOR, "machine as generator, +1", 1.0),
        (1, ENGINE, "engine, +2 %", 0.02),
        (1, MASS, "mass, +2 %", 0.02),
        (1, SLOPE, "slope [rad], 0.003", 0.003),
    )
    for k, (row, place, label, truth) in enumerate(rows):
        axes[row].plot(t, trace.error[::_THIN, place], lw=1.0, label=label, color=f"C{k}")
        first = 400.0 if row == 0 else 0.0
        axes[row].plot([first, t[-1]], [truth, truth], color=f"C{k}", lw=0.6, ls="--")
    axes[2].plot(t, trace.wald[::_THIN], lw=1.0, label="T7 over its threshold")
    axes[2].axhline(1.0, color="k", lw=0.6, ls=":")
    axes[0].set_ylabel("error of torque")
    axes[1].set_ylabel("what nobody measures")
    axes[1].set_ylim(-0.05, 0.05)
    axes[2].set_ylabel("$T_{norm}$")
    axes[2].set_xlabel("t [s]")
    for axis in axes:
        _shade(axis, trace)
        axis.legend(fontsize=8, loc="center right")
        axis.set_xlim(0, t[-1])
    axes[0].set_title("T7: what its observer estimates, and what is true (dashed)", fontsize=10)
    return save(figure, path)


def draw(folder: Path, sensor: Compared, efficiency: Compared, seed: int) -> list[Path]:
    """Draw everything into a folder; returns the files.

    Args:
        folder: made if need be.
        sensor: conditions with the voltage sensor off.
        efficiency: conditions with half of the efficiency from 440 s on.
        seed: of the other drives.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return [
        _two_windows(
            folder / "fig5.png",
            sensor,
            f"Fig. 5: T4 in ICDS, voltage sensor 20 V off, noise {NOISE:g} times",
            ("(39)", "(41)"),
        ),
        _two_windows(
            folder / "fig6.png",
            efficiency,
            f"Fig. 6: T4 in ICDS, efficiency halved from 440 s on, noise {NOISE:g} times",
            ("(39)", "(41)", "(45)"),
        ),
        _fig7(folder / "fig7.png", seed),
        _fig8(folder / "fig8.png", seed),
        _fig9(folder / "fig9.png", sensor),
        _estimates(folder / "observer.png", seed),
    ]
