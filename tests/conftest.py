"""Settings for all tests."""

import os

import pytest
from hypothesis import settings

from gateway import log

# Machines are slow and shared: no test fails for being slow. In CI the same examples come every time.
settings.register_profile("local", deadline=None, print_blob=True)
settings.register_profile("ci", deadline=None, print_blob=True, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")


def _dealt(items, workers):
    """Begin with what takes longest: each worker takes a part of the list, and steals when it is done.

    Test kernels run in real time and mostly wait: one after the other on two workers they take longer than all else.
    """
    slow = [item for item in items if "test_guest" in item.nodeid]
    plain = [item for item in items if "test_plain_python" in item.nodeid]
    rest = [item for item in items if item not in slow and item not in plain]
    first = [slow[0::2], slow[1::2], plain] if workers >= 3 else [slow + plain]
    size = -(-len(items) // workers)
    dealt = []
    for mine in first:
        share = max(size - len(mine), 0)
        dealt += mine + rest[:share]
        rest = rest[share:]
    return dealt + rest


def pytest_collection_modifyitems(items):
    """Put the tests into an order in which no worker is left with the longest at the end."""
    items[:] = _dealt(items, int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))


@pytest.fixture(autouse=True)
def _plain_logging():
    """Log lines go to this test's standard error, whatever a test of the command line has set up."""
    log.reset()
