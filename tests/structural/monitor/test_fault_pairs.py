"""Which pairs of faults are listed beside the best one."""

from types import SimpleNamespace

import numpy as np
import pytest

from gateway_fdi.masks import unpack
from gateway_plants.structural.monitor import fault_pairs
from gateway_plants.structural.monitor.fault_pairs import LESS, PAIR_NEARLY


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_pair_that_takes_the_place_of_a_small_share_is_listed(monkeypatch, share):
    """Of three faults the first two fit best; the third takes the place of the second one.

    What is at stake is what the pair explains beside the first one; the third explains so many of its shares less.
    """
    explained, first = 1e6, 9e5
    less = LESS + share * PAIR_NEARLY * (explained - first)
    both = np.full((3, 3), -np.inf)
    both[0, 1] = both[1, 0] = explained
    both[0, 2] = both[2, 0] = explained - less
    s = SimpleNamespace(pair=np.array([0, 1]), two=explained, both=both, alone=np.array([first, 10.0, 10.0]))
    own = SimpleNamespace(sure=np.zeros(1, np.int64), paired=np.zeros(1, np.int64))
    monkeypatch.setattr(fault_pairs, "_at_stake", fault_pairs._at_stake.py_func)
    fault_pairs._list.py_func(s, SimpleNamespace(faults=3), own, 1.0)
    listed, sure = (unpack(mask[None, :], 3)[0].tolist() for mask in (own.paired, own.sure))
    assert listed == [True, True, share < 1.0]
    assert sure == [True, share > 1.0, False]
