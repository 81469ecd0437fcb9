"""What healthy logs say of the plant: its matrices refined, how sure they are, its noise (``gateway calibrate``).

The logs are replayed by the healthy hypothesis alone (:mod:`gateway_plants.linear.model_set`), which estimates the
errors of the entries as it goes: a Kalman filter of state and parameters, recursive least squares of prediction errors
with the user's matrices and bounds as the start. What it has found at a log's end is the start of the next one. The
bound that is left is four standard deviations, and a share of the entry, since no plant stays what it is. Where a log's
innovations are larger than told, sensors and states have more noise by that factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Any

import numpy as np

from gateway.monitors.contract import Refined
from gateway_plants.linear.monitor.uncertain import UncertainPlantParams

#: Relative bound where none is told.
UNTOLD = 0.1
#: Standard deviations, and least share of an entry, of the bound that is left.
SURE, LEAST = 4.0, 0.005
#: Fit beyond which the noise told is too small.
NOISY = 1.1


def wanted(p: UncertainPlantParams) -> Mapping[str, Any]:
    """Return the keys with which logs are replayed: in which nothing is judged, and all is learned."""
    return {"model_error": UNTOLD if p.model_error is None else p.model_error, "learning": True}


def found(p: UncertainPlantParams, s: Any) -> Refined:
    """Return what a log says.

    Args:
        p: parameters with which it was replayed.
        s: state at its end; its ``models`` is a record of :class:`gateway_plants.linear.model_set.records.State`.
    """
    entries, n, m = p.entries, p.plant.states, p.plant.inputs
    x = s.models.filters
    errors = np.array(x.z[0][n : n + len(entries)])
    spread = np.sqrt(np.maximum(np.diag(np.array(x.cov[0]))[n : n + len(entries)], 0.0))
    whole = np.hstack([np.array(p.a), np.array(p.b)])
    bounds = np.zeros_like(whole)
    rows = []
    for row, column, error, sd in zip(entries.row, entries.column, errors, spread, strict=True):
        told = float(whole[row, column])
        whole[row, column] += error
        bounds[row, column] = max(SURE * sd, LEAST * abs(whole[row, column]))
        name = f"a[{row + 1}][{column + 1}]" if column < n else f"b[{row + 1}][{column - n + 1}]"
        rows.append((name, told, float(whole[row, column]), float(sd)))
    samples = max(int(s.models.fitted), 1)
    fit = float(s.models.fit) / samples / p.plant.outputs
    keys: dict[str, Any] = {
        "a": whole[:, :n].tolist(),
        "b": whole[:, n : n + m].tolist(),
        "model_error": {"a": bounds[:, :n].tolist(), "b": bounds[:, n : n + m].tolist()},
    }
    if fit > NOISY:
        more = sqrt(fit)
        keys["state_noise"] = [value * more for value in p.disturbance]
        keys["output"] = [part.model_copy(update={"noise": part.noise * more}) for part in p.output]
        rows += [(f"noise of {part.name}", part.noise, part.noise * more, 0.0) for part in p.output]
    return Refined(keys, tuple(rows), fit)
