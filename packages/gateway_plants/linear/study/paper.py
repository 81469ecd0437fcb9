"""What a reader of paper 003 looks for, beside what comes out here."""

from __future__ import annotations

from math import isinf

import numpy as np
from numpy.typing import NDArray

from gateway_bench.cli.study import Claim, claim
from gateway_plants.linear.study import example
from gateway_plants.linear.study.continuous import Told, observe, spans

#: Plants whose parameters are off, their first seed, and by how much: each entry of A and B but 0 and 1.
PLANTS, FIRST, OFF = 20, 100_000, (0.001, 0.01, 0.05)


def _span(flag: NDArray[np.bool_]) -> str:
    return " ".join(f"[{on:g}, {'end' if isinf(off) else f'{off:g}'})" for on, off in spans(flag)) or "-"


def figures() -> list[dict[str, str]]:
    """Return the flags of Figs. 3 to 11, a row a case."""
    rows = []
    for name, parts in example.FIGURES.items():
        told = observe(*example.held(example.case(*parts)))
        row = {"figure": name, "case": " ".join(parts)}
        for i in range(2):
            row[f"r_a{i + 1}"] = _span(told.actuators[:, i])
            row[f"r_a{i + 1} as printed"] = _span(told.printed[:, i])
        for i in range(3):
            row[f"r_s{i + 1}"] = _span(told.sensors[:, i])
        rows.append(row)
    return rows


def _clean(told: Told, parts: tuple[str, ...]) -> bool:
    """Tell whether the right flags went up and no other, and none of an actuator went down again."""
    up = [f"a{i + 1}" for i in range(2) if told.actuators[:, i].any()]
    up += [f"s{j + 1}" for j in range(3) if told.sensors[:, j].any()]
    return up == list(parts) and all(len(spans(flag)) < 2 for flag in told.actuators.T)


def off(entries: tuple[tuple[float, ...], ...], share: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a matrix whose entries, but 0 and 1, are each wrong by up to a share."""
    found = np.array(entries)
    return np.where(np.isin(found, (0.0, 1.0)), found, found * (1 + rng.uniform(-share, share, found.shape)))


def robust(share: float) -> tuple[int, int]:
    """Return on how many plants that are off the bank is silent when healthy, and how many of their figures are clean.

    Figures: 3 to 7, one fault each.
    """
    silent = clean = 0
    for seed in range(FIRST, FIRST + PLANTS):
        rng = np.random.default_rng(seed)
        plant = off(example.A, share, rng), off(example.B, share, rng)
        silent += _clean(observe(*example.held(()), plant=plant), ())
        cases = [parts for parts in example.FIGURES.values() if len(parts) == 1]
        clean += sum(_clean(observe(*example.held(example.case(*p)), plant=plant), p) for p in cases)
    return silent, clean


def claims(rows: list[dict[str, str]]) -> list[Claim]:
    """Return what the paper has, and what comes out here, of the rows of :func:`figures`."""
    found = []
    for row, parts in zip(rows, example.FIGURES.values(), strict=True):
        up = [f"{flag} {span}" for flag, span in row.items() if flag[:2] == "r_" and "printed" not in flag]
        told = observe(*example.held(example.case(*parts)))
        why = "the sensor's fault moves all observers but one"
        seen = ", ".join(each for each in up if not each.endswith("-"))
        wanted = " and ".join(f"r_{part}" for part in parts)
        found.append(claim(f"{row['figure']}: {row['case']}", wanted, seen, _clean(told, parts), why))
    printed = [f"{row['figure']}: {flag[:4]} {span}" for row in rows for flag, span in row.items()
               if row["case"][0] == "s" and "printed" in flag and span != "-"]  # fmt: skip
    why = "k != i leaves out the one observer that is right; (16) above is over all k"
    found.append(claim("(16) as printed", "no r_a for a sensor", "; ".join(printed), not printed, why))
    pulse = max(float(span.split()[1][:-1]) - 4.0 for row in rows for flag, span in row.items()
                if flag[:3] == "r_s" and span != "-")  # fmt: skip
    why = "where p - 1 = m, e is 0 once the observers stand"
    found.append(claim("(15): r_s = 1 means at fault", "stays", f"at most {pulse:.1f} s", pulse > 7.0, why))
    sizes = observe(*example.held(example.case("a1"))).omega[-1, :, 0]
    near = bool(np.allclose(sizes, 0.05, atol=5e-4))
    found.append(claim("(13): size of actuator 1's fault", "0.05", f"{sizes.min():.3f} to {sizes.max():.3f}", near))
    a, b, c = (np.array(x) for x in (example.A, example.B, example.C))
    ranks = [int(np.linalg.matrix_rank(np.block([[a, b], [np.delete(c, i, 0), np.zeros((2, 2))]]))) for i in range(3)]
    found.append(claim("Theorem 1: the ranks", "n + m = 6", ", ".join(map(str, ranks)), set(ranks) == {6}))
    for share in OFF:
        silent, clean = robust(share)
        here = f"healthy silent {silent} of {PLANTS} plants; Figs. 3 to 7 clean {clean} of {5 * PLANTS}"
        text = f"section 1: robust; A and B off by {100 * share:g} %"
        why = "the plant is unstable: what is off grows with its state"
        found.append(claim(text, "no figure", here, 5 * silent == clean == 5 * PLANTS, why))
    return found
