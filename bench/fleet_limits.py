"""Limits of many cars: how often the interval that is told has the rate of false alarms, over many simulated fleets.

``python bench/fleet_limits.py [--fleets N] [--only K]``: each fleet is seen for some hours a car, its minutes told
as a car tells them; the rate is computed exactly over other cars, and days. Wanted are 10 false alarms in 1e5 h.
``--issue`` has five fleets one by one, beside limits of a car's own hour.
"""

import argparse
import sys
from itertools import accumulate

import numpy as np
from scipy.stats import laplace, norm
from scipy.stats import t as student

from gateway_fdi.tails import exceeded_once
from gateway_fleet.live.pool import CONFIDENCE, pool, shown
from gateway_fleet.live.statistics import _summary

MINUTES, SECONDS = 60, 60


def of_student(nu):
    unit = np.sqrt((nu - 2) / nu)
    return lambda rng, size: rng.standard_t(nu, size) * unit, lambda x: student.sf(x / unit, nu)


#: Law of a value, with deviation 1: draws, and share above a level.
LAWS = {
    "t3": of_student(3),
    "t6": of_student(6),
    "Laplace": (lambda rng, size: rng.laplace(0, np.sqrt(0.5), size), lambda x: laplace.sf(x, 0, np.sqrt(0.5))),
    "normal": (lambda rng, size: rng.standard_normal(size), norm.sf),
}
#: Name -> law, cars, hours of each, days (0: all of one), deviation of a day's shift, which all cars have.
FLEETS = {
    "tail of Student's t, 6 degrees of freedom": ("t6", 300, 1, 0, 0.0),
    "3 degrees of freedom": ("t3", 300, 1, 0, 0.0),
    "Laplace's": ("Laplace", 300, 1, 0, 0.0),
    "normal": ("normal", 300, 1, 0, 0.0),
    "t6, ten days that shift all cars by 1": ("t6", 300, 1, 10, 1.0),
    "t6, 1000 cars of two hours": ("t6", 1000, 2, 0, 0.0),
    "t6, 30 cars, own centre": ("t6", 30, 1, 0, 0.0),
}


def cars_of(rng, count):
    """Each car has its own centre and its own spread."""
    return rng.normal(size=count), np.exp(rng.normal(0, 0.2, count))


def false_alarms(law, limits, centres, spreads, *, shifts=(0.0,)):
    """Hours with an alarm in 1e5 h, exactly."""
    rates = [LAWS[law][1]((limits - centres - shift) / spreads) for shift in shifts]
    return float(-np.expm1(MINUTES * SECONDS * np.log1p(-np.array(rates))).mean()) * 1e5


def drive(values, day):
    """An hour as a car tells it, read again."""
    unit, values, weights = _summary(sorted(values))
    return [value * 2.0**unit for value in accumulate(values)], weights, day


def fleet(name, seed):
    """Return the limit of a fleet, its rate as told (expected, ends) and as it is, in 1e5 h."""
    law, count, hours, days, deviation = FLEETS[name]
    rng = np.random.default_rng(seed)
    centres, spreads = cars_of(rng, count)
    shift = rng.normal(0, deviation, max(days, 1)) if days else np.zeros(1)
    cars = []
    for centre, spread in zip(centres, spreads, strict=True):
        when = rng.integers(0, len(shift), hours)
        worst = LAWS[law][0](rng, (hours, MINUTES, SECONDS)).max(2)
        cars.append(shown([drive(centre + spread * w + shift[day], day) for w, day in zip(worst, when, strict=True)]))
    found = pool(cars, 60.0, 1e-4)
    if found.own:
        real = false_alarms(law, np.array(found.each), centres, spreads)
    else:
        real = false_alarms(
            law, found.limit, *cars_of(rng, 2000), shifts=rng.normal(0, deviation, 50) if days else (0.0,)
        )
    return found.limit, *(1e5 * one for one in found.per_hour), real


def coverage(options):
    """Print a row a kind of fleet."""
    print(f"| {options.fleets} fleets each | limit (middle) | false alarms in 1e5 h (mean) | within | above | below |")
    print("|---|---|---|---|---|---|")
    for place, name in enumerate(FLEETS):
        if options.only not in (None, place):
            continue
        seeds = range(options.first, options.first + options.fleets)
        found = np.array([fleet(name, [2031, place, seed]) for seed in seeds])
        limit, _, low, high, real = found.T
        above, below = (real > high * (1 + 1e-9)).mean(), (real < low).mean()
        shares = f"{1 - above - below:.1%} | {above:.1%} | {below:.1%}"
        print(f"| {name} | {np.median(limit):.0f} | {real.mean():.1f} | {shares} |", flush=True)
    print(f"told for {CONFIDENCE:.0%}")


def issue(_options):
    """Print five fleets of 300 cars, and what limits of a car's own hour come to."""
    sums = []
    for seed in range(5):
        limit, expected, low, high, real = fleet(next(iter(FLEETS)), [2030, seed])
        rng = np.random.default_rng([2030, seed])
        centre, spread = cars_of(rng, 4000)
        hour = centre[:, None] + spread[:, None] * LAWS["t6"][0](rng, (4000, MINUTES, SECONDS)).max(2)
        own = np.array([exceeded_once(each, 600_000.0, heavy=True) for each in hour])
        sums.append((real, false_alarms("t6", own, centre, spread)))
        told = f"{expected:.2g} ({low:.2g} to {high:.1f})"
        print(f"| {seed} | {limit:.1f} | {told} | {real:.2g} | {sums[-1][1]:.0f} |")
    print("| mean | | | {:.2g} | {:.0f} |".format(*np.mean(sums, axis=0)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleets", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, help="number of the kind of fleets, from 0")
    parser.add_argument("--issue", action="store_true")
    arguments = parser.parse_args()
    sys.exit((issue if arguments.issue else coverage)(arguments))
