"""The times of frames on a bus whose ECUs have clocks of their own: tasks, arbitration, host stamps, another sender."""

import heapq

import numpy as np

#: Time that a frame takes on the bus [s].
FRAME_S = 0.24e-3


def arbitrated(released, priority):
    """Return when frames end on the bus, one after the other, the lowest priority number of those that wait first."""
    out, waiting, k, now = np.empty(len(released)), [], 0, 0.0
    while k < len(released) or waiting:
        now = now if waiting else max(now, released[k])
        while k < len(released) and released[k] <= now:
            heapq.heappush(waiting, (priority[k], k))
            k += 1
        now += FRAME_S
        out[heapq.heappop(waiting)[1]] = now
    return out


def bus(rng, seconds, *, messages=10, another=None, receiver_ppm=lambda t: 30.0):
    """Return times [s] and message numbers of frames.

    Args:
        rng: source of all randomness.
        seconds: how long.
        messages: how many, of 10 or 20 ms, of four ECUs.
        another: message, time [s], difference of the skew [ppm] of another sender from then on, in phase; None.
        receiver_ppm: time -> skew of the receiver's clock.
    """
    skews, released, number = rng.uniform(-100, 100, 4), [], []
    for m in range(messages):
        period = 0.01 if m % 2 else 0.02
        t = rng.uniform(0, 0.02) + np.arange(int(seconds / period)) * period * (1 + skews[m % 4] * 1e-6)
        if another is not None and another[0] == m:
            beyond = np.maximum(t - another[1], 0.0)
            t = t + beyond * another[2] * 1e-6
        t = t[rng.random(len(t)) > 1e-3] + 0.0  # some are lost
        released.append(t + rng.exponential(5e-5, len(t)))
        number.append(np.full(len(t), m))
    released, number = np.concatenate(released), np.concatenate(number)
    order = np.argsort(released, kind="stable")
    released, number = released[order], number[order]
    t = arbitrated(released, number)
    order = np.argsort(t, kind="stable")
    t, number = t[order], number[order]
    late = rng.exponential(4e-5, len(t)) + (rng.random(len(t)) < 2e-4) * rng.exponential(3e-3, len(t))
    t = np.maximum.accumulate(t + late)
    grid = np.arange(0.0, seconds + 10.0)
    walked = np.concatenate([[0.0], np.cumsum([receiver_ppm(x) * 1e-6 for x in grid[:-1]])])
    return t + np.interp(t, grid, walked), number
