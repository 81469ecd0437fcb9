"""Enough MSO sets: they are sets, and tell what all of them tell; of the battery pack of 64 cells too."""

import numpy as np
import pytest
from random_models import random_model

from bench.battery_pack import battery_model
from gateway_fdi.structure.analysis import analyse
from gateway_fdi.structure.candidates import classify
from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.incidence import counted
from gateway_fdi.structure.isolability import isolability_of_model, isolability_of_tests, signatures
from gateway_fdi.structure.mso import TooManySetsError, find_msos
from gateway_fdi.structure.selection import fewest_tests
from gateway_fdi.structure.sufficient import sufficient_msos


def every_one(sets):
    return np.ones(len(sets), bool)


@pytest.mark.parametrize("seed", range(20))
def test_random_models(seed):
    model = random_model(seed, 8 + seed, 2 + seed % 4, states=seed % 3)
    every = {row.tobytes() for row in find_msos(counted(model))}
    found = sufficient_msos(model, every_one)
    assert {row.tobytes() for row in found} <= every
    best = isolability_of_model(model)
    told = isolability_of_tests(model.faults, signatures(model, found))
    assert (told.detectable == best.detectable).all()
    seen = best.detectable
    assert (told.confused[seen] == best.confused[seen]).all()


def test_what_cannot_be_computed_is_searched_for_again(load):
    """As much as all sets that can be computed tell, though half of them are said not to be usable."""
    model = load("truck")
    every = find_msos(counted(model))
    good = {row.tobytes() for row in every[::2]}
    found = sufficient_msos(model, lambda sets: np.array([row.tobytes() in good for row in sets]))
    usable = [row for row in found if row.tobytes() in good]
    wanted = isolability_of_tests(model.faults, signatures(model, every[::2]))
    told = isolability_of_tests(model.faults, signatures(model, np.array(usable)))
    assert (told.confused == wanted.confused).all()


@pytest.mark.parametrize("cells", [4, 8, 16, pytest.param(64, marks=pytest.mark.full("5 s"))])
def test_the_pack_s_sets_end(tmp_path, cells):
    """64 cells have about 2^64 sets; the search must come to the limit, and to enough of them."""
    path = tmp_path / "pack.toml"
    path.write_text(battery_model(cells))
    model = load_model(path)
    if cells > 8:
        with pytest.raises(TooManySetsError):
            find_msos(counted(model), limit=1000)
    found = analyse(model, limit=1000 if cells > 8 else 20_000)
    assert bool(found.beyond) == (cells > 8)
    told = isolability_of_tests(model.faults, found.signature)
    assert (told.confused == found.best.confused).all()
    assert (found.isolability("SDI").confused == found.best.confused).all()
    one_less = classify(model, found.msos)
    assert len(one_less) == found.msos.sum()
    # one test a cell, that of all sensors, that of all models, and few more
    chosen = fewest_tests(found.signature)
    assert cells < len(chosen) <= cells + 6
    assert (isolability_of_tests(model.faults, found.signature[chosen]).confused == found.best.confused).all()
