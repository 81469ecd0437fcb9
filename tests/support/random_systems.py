"""Random components, tests and verdicts, for tests of diagnoses."""

import math

from gateway_fdi.diagnosis.diagnoser import Diagnoser
from gateway_fdi.diagnosis.state import FAILED, NOT_TESTED, PASSED
from gateway_fdi.diagnosis.system import Component, Link, Test


def a_system(rng, most=16):
    count = int(rng.integers(1, most + 1))
    components = [Component(f"c{k}", prior=float(10 ** rng.uniform(-4, -0.5))) for k in range(count)]
    density = rng.uniform(0.1, 0.6)
    tests = []
    for k in range(int(rng.integers(1, 13))):
        signed = rng.random() < 0.5
        links = tuple(
            Link(
                c.name,
                float(rng.uniform(0.02, 0.999)),
                float(rng.normal()) if signed and rng.random() < 0.8 else math.nan,
            )
            for c in components
            if rng.random() < density
        )
        if rng.random() < 0.5:  # some are seen by way of the first one
            links = tuple(one._replace(via=links[0].component if rng.random() < 0.5 else "") for one in links)
        tests.append(
            Test(
                f"t{k}",
                links,
                false_alarm=float(10 ** rng.uniform(-5, -1)),
                delay_s=float(rng.choice([0.0, 1.0, 5.0])),
                noise=float(rng.uniform(0.1, 2.0)) if signed else math.nan,
                gain_error=float(rng.choice([0.0, 0.05, 0.3])),
            )
        )
    return components, tests


def some_updates(rng, components, tests):
    """Return updates in order of time; what fails mostly comes of one or two components."""
    faulty = set(rng.choice(len(components), int(rng.integers(0, 3))).tolist())
    updates = []
    for test in tests:
        t = 0.0
        for _ in range(int(rng.integers(1, 4))):
            t += float(rng.choice([0.0, 0.5, 1.0, 5.0]))
            sees = any(int(link.component[1:]) in faulty for link in test.links)
            chance = [0.1, 0.1, 0.8] if sees and t > 1 else [0.15, 0.75, 0.1]
            verdict = int(rng.choice([NOT_TESTED, PASSED, FAILED], p=chance))
            residual = float(rng.normal() * 3) if rng.random() < 0.8 else math.nan
            updates.append((test.name, verdict, round(t * 1e9), residual))
    return sorted(updates, key=lambda one: one[2])


def ran(components, tests, updates, bounds=None):
    diagnoser = Diagnoser(components, tests, bounds)
    for update in updates:
        diagnoser.update(*update)
    return diagnoser
