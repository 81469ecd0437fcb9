"""Thresholds and noise from healthy records."""

import numpy as np
import pytest
from scipy import stats

from gateway_fdi.errors import InputError
from gateway_fdi.evidence import alarm, healthy, record
from gateway_fdi.evidence.model import Fault, Model, Slow

SEED = 6703


def test_the_law_is_that_of_the_largest_of_looks():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    maxima = 2.0 * stats.chi2(1).isf(-np.expm1(np.log(rng.random(4000)) / 50))
    law = alarm.fit(maxima, 0.1)
    assert law.looks == pytest.approx(500, rel=0.2)
    assert law.scale == pytest.approx(2.0, rel=0.05)
    threshold = law.threshold(0.01)
    assert law.rate(threshold) == pytest.approx(0.01, rel=1e-6)
    assert threshold == pytest.approx(law.scale * stats.chi2(1).isf(0.01 / law.looks), rel=1e-6)
    assert alarm.supported(3.0) == pytest.approx(1.0, rel=0.01)
    for wrong in ([1.0, 2.0], [0.0] * 9, [np.nan] * 9):
        with pytest.raises(InputError):
            alarm.fit(wrong, 1.0)


def plant(rng, jitter, n=4000):
    """Return a model, and a healthy record of it: one slow error that jitters, two residuals, coloured noise."""
    model = Model(
        (Slow("x", 1.0, 1e-3),), (Fault("a", (0,), 3.0), Fault("b", (1,), 3.0)), np.eye(2), 0.1, 20, jitter, np.inf
    )
    white = rng.normal(size=(n + 4, 2)) @ np.array([[1.0, 0.5], [0.0, 0.8]])
    noise = sum(white[k : k + n] for k in range(4))
    h = np.stack([np.sin(0.05 * np.arange(n)), 1.0 + 0.0 * np.arange(n)], 1)[:, :, None]
    moves = rng.normal() + jitter * np.repeat(rng.normal(size=n // 20), 20)
    return model, (noise + h[:, :, 0] * moves[:, None], h, np.ones((n, 2)))


def law_scale(model, records):
    """Return by how much the noise was made larger than that of sums over blocks."""
    return model.noise[0, 0] / healthy.noise(records, model.slow, model.samples)[0, 0]


@pytest.mark.parametrize(("jitter", "low", "high"), [(0.0, 0.0, 0.3), (2.0, 0.3, 3.0)])
def test_noise_and_jitter_are_those_of_healthy_records(jitter, low, high):
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    records = [plant(rng, jitter)[1] for _ in range(8)]
    model, law, hours = healthy.fitted(plant(rng, jitter)[0], records, 0.1)
    assert hours == pytest.approx(8 * 400 / 3600)
    assert low <= model.jitter <= high
    if jitter == 0.0:
        mixed = np.array([[1.0, 0.5], [0.0, 0.8]])
        wanted = 16.0 * mixed.T @ mixed * law_scale(model, records)
        assert model.noise == pytest.approx(wanted, rel=0.2, abs=1.0)
    assert law.rate(model.threshold) == pytest.approx(0.1, rel=1e-6)
    fresh = [plant(rng, jitter)[1] for _ in range(4)]
    assert all(told.kind == 0 for each in fresh for told in record.over(model, *each).told)
    faulty = fresh[0][0].copy()
    faulty[2000:, 0] += 6.0
    course = record.over(model, faulty, *fresh[0][1:])
    assert course.told[-1].faults == (0,)
    assert abs(course.told[-1].since - 100) <= 1
    assert abs(course.size[-1, 0] - 6.0) < 4.0 * course.spread[-1, 0]


def test_noise_of_a_plant_of_which_nothing_is_off_is_that_of_its_residuals():
    white = np.random.default_rng(SEED).normal(size=(4000, 1))
    found = healthy.noise([(white, np.zeros((4000, 1, 0)), np.zeros((4000, 0)))], (), 20)
    assert found == pytest.approx(np.eye(1), rel=0.4)
