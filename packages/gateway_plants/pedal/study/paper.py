"""What a reader of paper 002 looks for, beside what comes out here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gateway_bench.cli.study import Claim, claim
from gateway_plants.pedal.ecu import strokes
from gateway_plants.pedal.study.cases import IDEAL, SAMPLES, SPAN, TEN_BIT, Case, Environment, Run
from gateway_plants.pedal.study.follow import follow
from gateway_plants.pedal.study.table import RATES, T1, T2, VALUES, Score

#: Figs. 11, 12: voter -> IAE at 15 % of impulses, and at a value of 15 %; the points of Figs. 13, 14 that have numbers.
IAE = {"average": (33.897, 33.402), "median": (8.524, 4.338), "KHR": (1.898, 1.226)}
GAINS = {
    "Fig. 13, rate 8 %": (RATES[3], 15),
    "Fig. 13, rate 9 %": (RATES[4], 30),
    "Fig. 14, value 8 %": (VALUES[3], 30),
    "Fig. 14, value 15 %": (T2, 7),
}
#: Fig. 10: a channel at 0 V from the latest time on that is tried, 650 ms.
DEAD = Case("dead", onset=650)
#: Cases that the table needs.
CASES = (T1, T2, RATES[0], VALUES[0], DEAD, *(case for case, _ in GAINS.values()))
_NEAR = 0.05


def _worked_example() -> list[float]:
    """Return what KHR makes of samples 746 to 748 where the text has them: 2.84, 1.45, 1.80 V and 0 V."""
    truth = SPAN * strokes.exponential(1e-3 * np.arange(SAMPLES, dtype=np.float64))
    y = np.column_stack([truth, truth, truth])
    y[746:749, 0], y[746:749, 1] = (2.84, 1.45, 1.80), 0.0
    found = follow("KHR", IDEAL, Run(truth, y, y != truth[:, None], -1, SAMPLES)).value[746:749]
    return [float(value) for value in found]


def _settled() -> int:
    """Return after how many samples the Kalman gain, with the paper's P = 1, Q = 1, R = 0.5, stands within 0.001."""
    p, gains = 1.0, []
    for _ in range(100):
        p += 1.0
        gains.append(p / (p + 0.5))
        p *= 1.0 - gains[-1]
    return int(np.flatnonzero(np.abs(np.array(gains) - gains[-1]) > 1e-3)[-1]) + 2


def claims(scores: Sequence[Score]) -> list[Claim]:
    """Return what the paper has, and what comes out here, of the scores of a run that has all CASES."""
    by: Mapping[tuple[str, str, str], Score] = {
        (s.environment, s.case, s.voter): s for s in scores if s.stroke == "exponential"
    }

    def both(voter: str, case: Case) -> tuple[float, float]:
        ideal, digitised = (by[e.name, str(case), voter].iae for e in (IDEAL, TEN_BIT))
        return ideal, digitised

    def gain(environment: Environment, case: Case) -> float:
        theirs, ours = (by[environment.name, str(case), voter].iae for voter in ("predictive", "KHR"))
        return 100 * (theirs - ours) / theirs

    found = []
    for figure, at, case in (("Fig. 11, rate 15 %", 0, T1), ("Fig. 12, value 15 %", 1, T2)):
        for voter, values in IAE.items():
            ours, value = both(voter, case), values[at]
            near = any(abs(each / value - 1) < _NEAR for each in ours)
            here = f"{ours[0]:.3f}; 10 bit {ours[1]:.3f}"
            rounding = by[TEN_BIT.name, "none", voter].iae
            why = f"rounding to 10 bit alone is {rounding:.2f}" if rounding > value else "neither is near"
            found.append(claim(f"{figure}: {voter}", str(value), here, near, why))
    for text, cases in (("rate", (RATES[0], T1)), ("value", (VALUES[0], T2))):
        few, many = (both("KHR", case) for case in cases)
        grown = [100 * (b / a - 1) for a, b in zip(few, many, strict=True)]
        here = f"{grown[0]:+.0f} %; 10 bit {grown[1]:+.0f} %"
        found.append(claim(f"KHR, {text} 5 to 15 %", "no influence", here, abs(grown[1]) < 5, "it grows"))
    for figure, (case, told) in GAINS.items():
        better = gain(IDEAL, case), gain(TEN_BIT, case)
        near = any(abs(each - told) < 5 for each in better)
        here = f"{better[0]:+.0f} %; 10 bit {better[1]:+.0f} %"
        why = "that voter's smoothing constant is not printed"
        found.append(claim(f"{figure}: KHR over predictive", f"+{told} %", here, near, why))
    dead = by[IDEAL.name, str(DEAD), "KHR"]
    here = f"mean {dead.iae:.0f}, median {dead.median:.3f}; {dead.latched} of {dead.runs} runs latch"
    why = "FT(k) is 0 once the output stands still"
    found.append(claim("Fig. 10: 0 V from 650 ms on", "0.067", here, abs(dead.iae - 0.067) < 0.02, why))
    quoted = _worked_example()
    here = ", ".join(f"{value:.2f}" for value in quoted)
    near = bool(np.allclose(quoted, (2.11, 2.10, 2.09), atol=0.015))
    found.append(claim("samples 746 to 748", "2.11, 2.10, 2.09 V", here, near))
    stands = _settled()
    why = "its gain does not grow from then on"
    found.append(claim("conclusion 2: iterations improve it", "yes", f"up to sample {stands}", stands > 10, why))
    return found
