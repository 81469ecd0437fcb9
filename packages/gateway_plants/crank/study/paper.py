"""What a reader of paper 000 looks for, from its equations (1) to (8), beside what comes out here.

Source: Kim, Suh, Park, Yun, "A Method of Fault Diagnosis for Engine Synchronization Using Analytical Redundancy"
(2003). The signal is the pulse time PT, the interval between two pulses, at constant speed::

    x[k+1] = x[k] + u[k] + f[k],   y[k] = x[k] + n[k]                                (1), (2)
    xh[k+1] = xh[k] + u[k] + D r[k],   r[k] = y[k] - xh[k]                           (6), (8)

Corrections to the print:

* (3), first line: the zeros lie in ``(n-1) Pi < k < n Pi - 1``; as printed the range is empty.
* (6), second line: the output equation is ``yh[k] = xh[k]``; printed ``y[k] = xh[k]``.
* Threshold: 1.0 in section 4 is 2.54 sqrt(gamma); the residual's deviation by (13) is ``sqrt(2 gamma / (2 - D))``.
* Count: the residual's duration tells it only for a narrow window of thresholds. The lag from the first exceedance to
  the largest residual of opposite sign is the count: missed 1 gives r / delta = 1, -(1+D), ...
* (4), (5) describe only the *displaced gap*. A pulse that is really missed leaves, at once, an interval of 2 alpha too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway_bench.cli.study import Claim, claim

#: Section 4 of the paper: a 30-2 wheel, D = 0.6, gamma = 0.16; alpha and beta are not printed and are chosen so that
#: the threshold 1 gives the durations it states.
PULSES, GAIN, GAMMA, ALPHA, BETA = 28, 0.6, 0.16, 2.0, 6.0
TURNS = 4
#: Threshold of section 4, and ours; runs of a claim, seeds from 0 on.
LEVELS, RUNS = (1.0, (BETA - ALPHA) / 2), 100
#: Largest count that the lag is read for.
LARGEST_COUNT = 3


def fault_signal(count: int, length: int, turn: int, pulses: int = PULSES) -> NDArray[np.float64]:
    """Return f / delta by (4), (5): the gap displaced by ``count`` pulses (added: below zero), once.

    Args:
        count: pulses missed (+) or added (-).
        length: samples.
        turn: the gap concerned is that at ``turn * pulses``.
        pulses: of one revolution.
    """
    f = np.zeros(length)
    n = turn * pulses
    if count > 0:
        steps = ((n - count - 1, 1), (n - count, -1), (n - 1, -1), (n, 1))
    else:
        steps = ((n - 1, -1), (n, 1), (n - count - 1, 1), (n - count, -1))
    for k, sign in steps:
        if 0 <= k < length:
            f[k] += sign
    return f


def paper_run(
    count: int, seed: int, *, noise: float = GAMMA**0.5, turns: int = TURNS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return pulse times y and residuals r of the paper's model and observer, alpha and delta as above.

    Args:
        count: pulses missed (+) or added (-) before the second gap, 0 for none; without correction every
            later gap is displaced too.
        seed: of the noise.
        noise: its standard deviation.
        turns: length in revolutions.
    """
    length, delta = turns * PULSES, BETA - ALPHA
    k = np.arange(length)
    u = np.where(k % PULSES == PULSES - 1, delta, 0.0) - np.where((k % PULSES == 0) & (k > 0), delta, 0.0)
    f = np.zeros(length)
    for turn in range(2, turns + 1) if count else ():
        f += delta * fault_signal(count, length, turn)
    x = ALPHA + np.concatenate([[0.0], np.cumsum(u + f)[:-1]])
    y = x + np.random.default_rng(seed).normal(0, noise, length)
    residuals = np.zeros(length)
    estimate = ALPHA
    for i in range(length):
        residuals[i] = y[i] - estimate
        estimate += u[i] + GAIN * residuals[i]
    return y, residuals


def deviation() -> float:
    """Return the residual's standard deviation by (13)."""
    return float((2 * GAMMA / (2 - GAIN)) ** 0.5)


def displacement(residuals: NDArray[np.float64], step: float) -> int:
    """Return by how many pulses the gap came early (+) or late (-), 0 if that is not what is seen.

    The lag of the largest residual of opposite sign is the count; that is at least 1.096 of the gap's step.

    Args:
        residuals: shape (5,) or more, from the first exceedance on.
        step: the gap's step delta.
    """
    opposite = -np.sign(residuals[0]) * residuals[1:5]
    lag = int(np.argmax(opposite)) + 1
    if lag > LARGEST_COUNT or opposite[lag - 1] < 0.65 * step:
        return 0
    return lag if residuals[0] > 0 else -lag


def _rates(count: int) -> NDArray[np.float64]:
    """Return how often a fault is the first alarm, its direction and its count are told; a row a threshold.

    Section 3.2: the first exceedance's sign is the direction, above zero: missed; the exceedances last from the fault
    signal's beginning to its end, count + 2 samples.
    """
    found, begins = np.zeros((len(LEVELS), 3)), 2 * PULSES - max(count, 0)
    for seed in range(RUNS):
        r = paper_run(count, seed, turns=3)[1]
        for k, level in enumerate(LEVELS):
            over = np.flatnonzero(np.abs(r) > level)
            mine = over[(over >= begins) & (over < begins + PULSES // 2)]
            right = mine[0] == begins and np.sign(r[begins]) == np.sign(count)
            found[k] += over[0] == begins, right, right and mine[-1] - mine[0] == abs(count) + 1
    return 100 * found / RUNS


def claims() -> list[Claim]:
    """Return what the paper has, and what comes out here."""
    counts = (1, 2, -1, -2)
    shapes = [fault_signal(count, 3 * PULSES, 1) for count in counts]
    spans = [int(np.ptp(np.flatnonzero(f))) + 1 for f in shapes]
    sums, signs = {float(f.sum()) for f in shapes}, [int(f[np.flatnonzero(f)[0]]) for f in shapes]
    healthy = np.abs([paper_run(0, seed, turns=3)[1] for seed in range(RUNS)])
    below = 100 * float((healthy < LEVELS[0]).mean())
    exact = [np.abs(paper_run(count, 0, noise=0.0)[1]) for count in counts]
    first = [float(r[r > 1e-9][0]) / (BETA - ALPHA) for r in exact]
    again = np.flatnonzero(exact[0] > LEVELS[0])
    again = again[again > again[0] + PULSES // 2]
    (alarm, sign, duration), ours = np.mean([_rates(count) for count in counts], axis=0)

    def shares(k: int, value: float) -> str:
        return f"{value:.0f} %; threshold delta / 2: {ours[k]:.0f} %"

    return [
        claim(
            "Fig. 2: 1, 2 pulses missed, 1, 2 added",
            "sum 0; begins +, +, -, -; a sample longer each",
            f"sum {', '.join(f'{s:g}' for s in sums)}; {signs}; {spans} samples",
            sums == {0.0} and signs == [1, 1, -1, -1] and spans == [3, 4, 3, 4],
        ),
        claim(
            "section 4: 2.54 deviations by (13)",
            "0.4 x 2.54 = 1.0",
            f"{deviation():.2f} x 2.54 = {2.54 * deviation():.2f}",
            abs(2.54 * deviation() - LEVELS[0]) < 0.05,
            "0.4 is the sensor's noise, not the residual's",
        ),
        claim("Fig. 3: noise below 1.0", "99 %", f"{below:.1f} %", below > 98.9, "the threshold is too low"),
        claim(
            "(14): first residual of a fault",
            "beta - alpha",
            f"{min(first):.2f} to {max(first):.2f} of it",
            bool(np.allclose(first, 1.0)),
        ),
        claim("Figs. 4, 5: no alarm before", "yes", shares(0, alarm), alarm > 99, "noise is above 1.0 first"),
        claim("sign of the first: missed or added", "always", shares(1, sign), sign > 99),
        claim(
            "duration: how many",
            "always",
            shares(2, duration),
            duration > 99,
            "its last residual is as small as 1.4; the lag of the opposite peak is read instead",
        ),
        claim(
            "Fig. 4: uncorrected, again a turn later",
            "before 60, near 100",
            f"at {2 * PULSES - 1}, {again[0]}",
            abs(float(again[0]) - 100) < 10,
            "three turns have 84 pulses",
        ),
    ]
