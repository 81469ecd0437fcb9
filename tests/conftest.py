"""Settings for all tests."""

import os

import pytest
import structlog
from hypothesis import settings

# Machines are slow and shared: no test fails for being slow. In CI the same examples come every time.
settings.register_profile("local", deadline=None, print_blob=True)
settings.register_profile("ci", deadline=None, print_blob=True, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")


def pytest_collection_modifyitems(items):
    """Begin with what takes longest, so that no worker is left with it at the end."""
    longest = ("test_guest", "test_plain_python")
    items.sort(
        key=lambda item: next((k for k, n in enumerate(longest) if n in item.nodeid), len(longest))
    )


@pytest.fixture(autouse=True)
def _plain_logging():
    """Log lines go to this test's standard error, whatever a test of the command line has set up."""
    structlog.reset_defaults()
