"""Clocks of senders, beside a least-squares fit of all windows at once, which is NumPy's."""

import numpy as np
import pytest

from gateway_fdi.clock import (
    FIRST,
    QUARTILE,
    SETTLED,
    UNKNOWN_SKEW,
    WINDOW,
    Clock,
    Const,
    close_window,
    is_steady,
    judge,
    take,
)
from gateway_fdi.jit import kernel, zeros

SEED = 5901
PERIOD_S, NOISE_S, MEMORY_S, KAPPA, LIMIT_S, LEARN_S = 0.01, 2e-5, 3.0, 1e-5, 2e-3, 2.0
OUT = ("offset", "skew", "p00", "p01", "p11", "residual", "walked", "up", "down", "dt", "level", "at_s")


@kernel
def follow(c, const, t_ns, out):
    """Take frames; returns how many windows they ended, whose results are in the rows of ``out``."""
    n = 0
    for t in t_ns:
        if take(c, t, const.noise_s, 0.0):
            dt = close_window(c, const, 0.0)
            level = judge(c, const, dt)
            for k, x in enumerate((c.offset, c.skew, c.p00, c.p01, c.p11, c.residual, c.walked, c.up, c.down)):
                out[n, k] = x
            out[n, 9], out[n, 10], out[n, 11] = dt, level, c.at_s
            n += 1
    return n


def followed(t_ns):
    """Follow one message from its first frame on; returns its clock, and a row of OUT for each window."""
    c, const = zeros(1, Clock)[0], zeros(1, Const)[0]
    const.noise_s, const.memory_s, const.kappa, const.limit_s = NOISE_S, MEMORY_S, KAPPA, LIMIT_S
    const.learn_s = LEARN_S
    out = np.zeros((len(t_ns) // WINDOW, len(OUT)))
    rows = out[: follow(c, const, t_ns, out)]
    return c, {name: rows[:, k] for k, name in enumerate(OUT)}


def stamps(skews, rng, late_s=1e-4, lost=0.05):
    """Return times of frames, one for each skew, and their numbers: the first learn the period, later ones get lost."""
    steps = PERIOD_S * (1.0 + np.asarray(skews))
    a = 5.0 + np.concatenate([[0.0], np.cumsum(steps)[:-1]]) + late_s * rng.uniform(size=len(steps))
    kept = (rng.uniform(size=len(a)) > lost) | (np.arange(len(a)) <= FIRST)
    return np.round(a * 1e9).astype(np.int64)[kept], np.flatnonzero(kept)


def test_it_is_the_weighted_least_squares_fit_of_all_windows():
    rng = np.random.default_rng(SEED)
    t_ns, numbers = stamps(np.r_[np.zeros(FIRST), np.full(2000, 2e-4)], rng)
    c, rows = followed(t_ns)
    period = (t_ns[FIRST] - t_ns[0]) * 1e-9 / FIRST
    assert c.period == pytest.approx(period, rel=1e-12), SEED
    a, n = (t_ns[FIRST + 1 :] - t_ns[FIRST]) * 1e-9, numbers[FIRST + 1 :] - FIRST
    count = len(a) // WINDOW
    a, n = (each[: count * WINDOW].reshape(count, WINDOW) for each in (a, n))
    at = a[:, -1]
    x, skew, begun = (np.r_[0.0, each[:-1]] for each in (rows["offset"], rows["skew"], at))  # of the window before
    beyond = np.sort(a - n * period - x[:, None] - skew[:, None] * (a - begun[:, None]))
    y = x + skew * (at - begun) + beyond[:, QUARTILE]
    np.testing.assert_allclose(rows["at_s"], at, rtol=1e-12)
    for k in (0, 1, 5, count - 1):
        age = at[k] - at[: k + 1]
        prior = np.diag([(8.0 * NOISE_S / period) ** 2, (NOISE_S / UNKNOWN_SKEW) ** 2])
        to_first = np.array([[1.0, -at[k]], [0.0, 1.0]])  # the prior is of the phase at the first frame
        h, w = np.stack([np.ones(k + 1), -age], axis=1), np.exp(-age / MEMORY_S)
        information = (h.T * w) @ h + np.exp(-at[k] / MEMORY_S) * to_first.T @ prior @ to_first
        x, p = np.linalg.solve(information, (h.T * w) @ y[: k + 1]), np.linalg.inv(information)
        np.testing.assert_allclose([rows["offset"][k], rows["skew"][k]], x, rtol=1e-6, err_msg=f"{SEED}, {k}")
        found = [rows["p00"][k], rows["p01"][k], rows["p11"][k]]
        np.testing.assert_allclose(found, [p[0, 0], p[0, 1], p[1, 1]], rtol=1e-6, err_msg=f"{SEED}, {k}")
        assert rows["residual"][k] == pytest.approx(y[k] - x[0], rel=1e-6, abs=1e-12), SEED
    assert is_steady(c)
    assert c.skew == pytest.approx(PERIOD_S * (1.0 + 2e-4) / period - 1.0, abs=2e-5)


def test_another_clock_grows_in_the_cusum_and_a_jump_does_not():
    rng = np.random.default_rng(SEED)
    same, other = np.zeros(FIRST + 1500), np.full(400, 5e-4)
    for sign, side, away in ((1.0, "up", "down"), (-1.0, "down", "up")):
        c, rows = followed(stamps(np.r_[same, sign * other], rng, lost=0.0)[0])
        known = np.cumsum(np.where(np.arange(len(rows["dt"])) < SETTLED, 0.0, rows["dt"]))
        up = 0.0
        for k, (dt, d) in enumerate(zip(rows["dt"], sign * rows["walked"], strict=True)):
            up = min(max(0.0, up + d - KAPPA * dt), 2.0 * LIMIT_S) if known[k] >= LEARN_S else 0.0
            assert rows[side][k] == pytest.approx(up, rel=1e-9, abs=1e-12), (SEED, k)
        assert rows["level"][: 1500 // WINDOW].max() < 0.1, SEED
        assert rows["level"][-1] == pytest.approx(up / LIMIT_S)
        assert up > 0.2 * LIMIT_S, "it is another clock"
        assert rows[away][-1] < 0.1 * up
        jumped = stamps(same, rng, lost=0.0)[0]
        jumped[FIRST + 1 + 60 * WINDOW :] += round(sign * 3e6)  # between two windows
        c, rows = followed(jumped)
        assert (c.jumps, c.windows > SETTLED) == (1, True), SEED
        assert rows["level"].max() < 0.1, SEED
        assert abs(rows["residual"][-1]) < 1e-4, "the phase is found again"
