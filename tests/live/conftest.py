"""Log lines of these tests go to their own standard error, whatever a test of the command line has set up."""

import pytest
import structlog


@pytest.fixture(autouse=True)
def _plain_logging():
    structlog.reset_defaults()
