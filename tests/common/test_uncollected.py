"""What is built without the collector: old at once, and what was frozen stays frozen."""

import gc

import pytest

from gateway.common import gc_pause as made
from gateway.common.gc_pause import gc_paused


@pytest.fixture
def unfrozen(monkeypatch):
    """As in a process that has frozen nothing yet; afterwards as the suite has it."""
    monkeypatch.setattr(made._Frozen, "seen", False)
    gc.unfreeze()
    yield
    gc.freeze()


def built():
    with gc_paused():
        assert not gc.isenabled()
        return [[k] for k in range(10)]


def test_what_is_built_is_old(unfrozen):
    result = built()
    assert gc.isenabled()
    assert any(each is result for each in gc.get_objects(generation=2))
    assert gc.get_freeze_count() == 0


def test_what_was_frozen_stays_so_and_is_counted_once(unfrozen, monkeypatch):
    """The count goes from object to object: with four a start, tests of restarts took ten times as long."""
    gc.freeze()
    count, asked = gc.get_freeze_count, []
    monkeypatch.setattr(gc, "get_freeze_count", lambda: asked.append(1) or count())
    for _ in range(5):
        built()
    assert asked == [1]
    assert count() > 1000
