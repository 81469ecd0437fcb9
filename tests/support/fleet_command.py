"""A mark of tests that call a command of gateway_fleet, in files of which the rest does without it."""

import pytest
from uses import lacking

needs_fleet = pytest.mark.skipif(lacking("gateway_fleet"), reason="the command is of gateway_fleet")
