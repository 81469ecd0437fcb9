"""Random cases that no choice was made on: right flags, no wrong one, none that drops out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_plants.linear.ecu.params import LinearFault
from gateway_plants.linear.pi_bank.masking import stationary
from gateway_plants.linear.study import example
from gateway_plants.linear.study.bank import run
from gateway_plants.linear.study.continuous import observe

KINDS = ("actuator", "sensor", "both")
METHODS = ("products, as printed", "products", "ours", "ours, with noise")
#: Seeds below were used while the decisions were made.
FIRST_SEED = 100_000


@dataclass(frozen=True)
class Row:
    """One method on the cases of one kind.

    Attributes:
        case: of KINDS.
        method: of METHODS.
        cases: how many.
        clean: share of them.
        unmasked: how many are outside the masked regions of (16).
        clean_unmasked: share of those.
        missed: cases in which a flag never came.
        false: in which a wrong one did.
        dropped: in which a right one went down again.
        delay_s: mean until the last right flag, of those that came.
    """

    case: str
    method: str
    cases: int
    clean: float
    unmasked: int
    clean_unmasked: float
    missed: int
    false: int
    dropped: int
    delay_s: float


def draw(rng: np.random.Generator) -> tuple[str, tuple[LinearFault, ...]]:
    """Return a random case: |a| 0.02 to 0.2 from 2 s on, |s| 0.15 to 1.5, up to 6 s later; either sign."""
    kind = KINDS[rng.integers(3)]
    begin = 2.0 + float(rng.uniform(0.0, example.PERIOD))
    faults = []
    if kind != "sensor":
        size = float(rng.uniform(0.02, 0.2) * rng.choice((-1, 1)))
        faults.append(LinearFault(kind="actuator_offset", place=int(rng.integers(1, 3)), from_s=begin, size=size))
    if kind != "actuator":
        size = float(rng.uniform(0.15, 1.5) * rng.choice((-1, 1)))
        later = begin + float(rng.uniform(0.0, 6.0))
        faults.append(LinearFault(kind="output_offset", place=int(rng.integers(1, 4)), from_s=later, size=size))
    return kind, tuple(faults)


def masked(faults: tuple[LinearFault, ...]) -> bool:
    """Tell whether (16) loses the actuator's fault for good in a case: |a + G s| < Th_a in one observer."""
    if len(faults) < 2:
        return False
    a, s = faults
    moved = stationary(example.plant())[:, s.place - 1, a.place - 1] * s.size
    seen = [k for k in range(3) if k != s.place - 1]
    return bool((np.abs(a.size + moved[seen]) < example.ACTUATOR_LIMIT).any())


def _look(flags: NDArray[np.int64], faults: tuple[LinearFault, ...]) -> tuple[bool, bool, bool, float]:
    """Return (missed, false, dropped, delay of the last right flag [s]) of flags (n, 5)."""
    wanted = {(f.place - 1 if f.kind == "actuator_offset" else 1 + f.place): f for f in faults}
    missed = false = dropped = False
    delay = 0.0
    for k in range(5):
        on = np.flatnonzero(flags[:, k])
        if k not in wanted:
            false |= len(on) > 0
        elif not len(on):
            missed = True
        else:
            dropped |= not flags[on[0] :, k].all()
            delay = max(delay, on[0] * example.PERIOD - wanted[k].from_s)
    return missed, false, dropped, delay


def flags_of(method: str, faults: tuple[LinearFault, ...], seed: int) -> NDArray[np.int64]:
    """Return flags (n, 5) of a method on a case: two actuators, three sensors."""
    if method.startswith("products"):
        told = observe(*example.held(faults))
        actuators = told.printed if method.endswith("printed") else told.actuators
        # Pulses of (15) are latched: nothing else could be asked for.
        latched = np.maximum.accumulate(told.sensors, axis=0)
        return np.hstack([actuators, latched]).astype(np.int64)
    sigma = example.NOISE if method.endswith("noise") else 0.0
    found = run(faults, sigma, np.random.default_rng([seed, 1]))
    flags = np.hstack([found.actuators, found.sensors])
    flags[found.unexplained == 1] = 0
    return flags


def holdout(cases: int, seed: int, methods: tuple[str, ...] = METHODS) -> list[Row]:
    """Return all rows of the table.

    Args:
        cases: how many, of all kinds together.
        seed: of the first; one each.
        methods: of METHODS.
    """
    drawn = [draw(np.random.default_rng(seed + k)) for k in range(cases)]
    hidden = [masked(faults) for _, faults in drawn]
    rows = []
    for method in methods:
        seen = [_look(flags_of(method, faults, seed + k), faults) for k, (_, faults) in enumerate(drawn)]
        for kind in KINDS:
            mine = [k for k, (name, _) in enumerate(drawn) if name == kind]
            open_ = [k for k in mine if not hidden[k]]
            clean = {k: not any(seen[k][:3]) for k in mine}
            came = [seen[k][3] for k in mine if not seen[k][0]]
            rows.append(
                Row(
                    kind,
                    method,
                    len(mine),
                    float(np.mean([clean[k] for k in mine])),
                    len(open_),
                    float(np.mean([clean[k] for k in open_])),
                    sum(seen[k][0] for k in mine),
                    sum(seen[k][1] for k in mine),
                    sum(seen[k][2] for k in mine),
                    float(np.mean(came)) if came else float("nan"),
                )
            )
    return rows
