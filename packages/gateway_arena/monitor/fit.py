"""``gateway fit``: a method learns from healthy logs, as the gateway itself samples them.

The logs are replayed through the monitor's own connection, so that a method learns from what it will get. Of each
stretch without a gap the first part is learned from, the rest sets the threshold as ``gateway calibrate`` sets those of
stopping rules.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import gateway_api as api
from gateway.cli.present import find_config, print_json, say
from gateway_arena.contract import SAMPLES, Array, Found, NotForThisPlantError, Record, WithoutSlopes, cut
from gateway_arena.monitor.fitted_file import method_of, write
from gateway_arena.monitor.monitor import TYPE
from gateway_arena.monitor.params import Params
from gateway_arena.monitor.runner import Collector, collecting
from gateway_calibration.stopping import propose
from gateway_fdi.errors import InputError, named
from gateway_fdi.stopping import assured
from gateway_fdi.structure.model import Model

#: Share of a stretch that is learned from; records that it takes at least; time whose largest scores are one [s].
SHARE, LEAST, BLOCK_S = 0.6, 4, 1.0
#: Mean time between false alarms that a threshold is for [s].
MTFA_S = 8 * 3600.0
#: How far beyond the range of the healthy log a value is taken as it is, in such ranges.
BEYOND = 1e3
#: Methods that are monitors of their own, compiled.
_COMPILED = {"structural": "structural", "fixed": "structural", "pi_bank": "pi_bank", "kalman": "linear_observer"}


class Bus(WithoutSlopes):
    """Facts that a method gets of a plant that is known by a log alone (:class:`gateway_arena.contract.Plant`)."""

    source, model = "a log", Model("log", (), ())

    def __init__(self, name: str, p: Params, healthy: Sequence[Array]) -> None:
        self.name, self.period_s, self.knowns = name, p.period_ms / 1e3, p.inputs
        self.commands: tuple[str, ...] = ()
        steps = np.concatenate([np.diff(values, axis=0) for values in healthy])
        self.noise = tuple((steps.std(0) / math.sqrt(2.0)).tolist())
        self.sizes: Mapping[str, str] = dict.fromkeys(p.faults, "of a log")

    def record(self, seed: int, fault: str = "", off: float = 0.0, size: float = 1.0) -> Record:
        """Refuse: there is a log only.

        Raises:
            NotForThisPlantError: always.
        """
        raise NotForThisPlantError("there is a log, and no simulation")


def fit(config: Path | None, logs: Sequence[Path], *, monitor: str | None, faults: Sequence[str], json: bool) -> int:
    """Fit a monitor of type ``method`` and write its file; returns the exit code.

    Args:
        config: the configuration.
        logs: healthy ones.
        monitor: its name, if the configuration has several.
        faults: ``"NAME=LOG@SECONDS"``, for methods that learn from faults: a log, and when the fault begins in it.
        json: print what was found as JSON.

    Raises:
        InputError, InputErrors: no such monitor; a log that is too short; a method that fails.
    """
    path = find_config(config)
    shown = fitted(path, logs, monitor=monitor, faults=faults)
    if json:
        print_json(shown)
    else:
        print(f"{shown['file']}: {shown['told']}")
    return 0


def fitted(path: Path, logs: Sequence[Path], *, monitor: str | None, faults: Sequence[str]) -> dict[str, Any]:
    """Do the work of :func:`fit`; returns what was found."""
    with collecting():
        name, p = _chosen(api.open(path), monitor)
    folder = path.resolve().parent
    made: Any = method_of(p, folder)[0]
    refuse(p.method, made, key="method")
    healthy = [stretch for log in logs for stretch in _stretches(path, log, p)]
    learned = [values[: int(SHARE * len(values))] for _, values in healthy]
    length = max(2 * p.settle, min(SAMPLES, min(map(len, learned), default=0) // LEAST))
    records = [_record(piece, p) for values in learned for piece in cut(values, length)]
    if len(records) < LEAST or length <= p.settle:
        need = math.ceil(LEAST * length / SHARE) * p.period_ms / 1e3
        got = sum(len(values) for _, values in healthy)
        text = f"{got} samples without a gap are too few: {need:g} s at least"
        raise InputError(text, file=logs[0], key="LOG", value=name)
    made.fit(Bus(name, p, learned), records, _faulty(path, faults, p) if getattr(made, "supervised", False) else ())
    held = [values[len(part) :] for (_, values), part in zip(healthy, learned, strict=True)]
    threshold, seconds = _threshold(made, held, p)
    low, high = (f([f(v, 0) for v in learned], 0) for f in (np.min, np.max))
    span = BEYOND * (high - low + 1e-9 * (1.0 + np.abs(high)))
    told = (
        f"{sum(map(len, learned))} samples learned, {seconds:.0f} s held out; threshold {threshold:.4g}; "
        f"assured by the data: {assured(seconds, 0):.0f} s between false alarms (95 %)"
    )
    facts = {
        "threshold": threshold, "low": (low - span).tolist(), "high": (high + span).tolist(), "told": told,
        "logs": {log.name: hashlib.sha256(log.read_bytes()).hexdigest() for log in logs},
    }  # fmt: skip
    write(folder / p.fitted, p, folder, made, facts)
    return {"monitor": name, "file": str(folder / p.fitted), **facts}


def refuse(name: str, made: Any, *, key: str) -> None:
    """Refuse a method that the gateway has as a monitor already, or that cannot be one.

    Raises:
        InputError: says which type it is, or what it lacks.
    """
    if name in _COMPILED:
        text = f'the gateway has this method as a monitor of its own, compiled: type = "{_COMPILED[name]}"'
        raise InputError(text, key=key, value=name)
    if not hasattr(made, "feed"):
        raise InputError("a monitor needs step: run wants whole records", key=key, value=name)


def _chosen(setup: api.Setup, wanted: str | None) -> tuple[str, Params]:
    found = {e.name: dict(e.model_extra or {}) for e in setup.config.monitor if e.type == TYPE}
    if wanted is None and len(found) == 1:
        (wanted,) = found
    if wanted is None or wanted not in found:
        text = f'monitors of type "{TYPE}" are {", ".join(found) or "none"}; --monitor NAME'
        raise InputError(text, file=setup.file, key="--monitor", value=wanted)
    return wanted, Params(**found[wanted])


def _stretches(path: Path, log: Path, p: Params) -> list[tuple[float, Array]]:
    """Return the samples of a log, stretch by stretch without a gap: time of the first [s], shape (n, inputs)."""
    with collecting() as found:
        run = api.open(path).replay(log)
    del run
    best: Collector = max(found[p.fitted], key=lambda one: len(one.t_ns))
    if not best.t_ns:
        raise InputError("no sample has all inputs", file=log, key="inputs", value=", ".join(p.inputs))
    t = np.array(best.t_ns)
    ends = np.flatnonzero(np.diff(t) > 1.5e6 * p.period_ms) + 1
    values = np.array(best.values)
    return [(float(ts[0]) / 1e9, rows) for ts, rows in zip(np.split(t, ends), np.split(values, ends), strict=True)]


def _record(values: Array, p: Params, fault: str = "", onset: int | None = None) -> Record:
    t_s: Array = np.arange(float(len(values))) * (p.period_ms / 1e3)
    return Record(t_s, values, fault, len(values) if onset is None else onset)


def _faulty(path: Path, faults: Sequence[str], p: Params) -> list[Record]:
    found = []
    for text in faults:
        name, _, rest = text.partition("=")
        log, _, seconds = rest.rpartition("@")
        try:
            at = float(seconds)
        except ValueError as error:
            raise InputError("NAME=LOG@SECONDS", key="--fault", value=text) from error
        if name not in p.faults:
            raise InputError(named("faults of the monitor are", name, p.faults), key="--fault", value=text)
        stretches = _stretches(path, Path(log), p)
        begun = stretches[0][0]
        for first, values in stretches:
            onset = round((at - (first - begun)) * 1e3 / p.period_ms)
            if onset < len(values):
                found.append(_record(values, p, name, max(onset, 0)))
    missing = set(p.faults) - {record.fault for record in found}
    if missing or not found:
        text = f"the method learns from faults: --fault {min(missing, default='NAME')}=LOG@SECONDS for each"
        raise InputError(text, file=path, key="faults", value=", ".join(p.faults))
    return found


def _threshold(made: Any, held: Sequence[Array], p: Params) -> tuple[float, float]:
    """Return the threshold that scores of samples give that were not learned from, and their time [s]."""
    block = max(1, round(BLOCK_S * 1e3 / p.period_ms))
    maxima: list[float] = []
    for values in held:
        made.reset()
        found: Found = made.feed(values)
        score = found.score[p.settle :]
        if not np.isfinite(score).all():
            raise InputError("its score of a healthy sample is no number", key="method", value=p.method)
        maxima += [float(score[k : k + block].max()) for k in range(0, len(score), block)]
    if len(maxima) < 2:
        raise InputError(f"no samples are left behind the {p.settle} that settle", key="LOG", value=p.method)
    seconds = sum(max(0, len(values) - p.settle) for values in held) * p.period_ms / 1e3
    usual = float(np.median(maxima))
    above = propose(np.maximum(np.array(maxima) - usual, 0.0), seconds, MTFA_S)
    say(f"largest healthy score {max(maxima):.4g}, usual {usual:.4g}")
    return max(usual + above, float(getattr(made, "least", -math.inf))), seconds
