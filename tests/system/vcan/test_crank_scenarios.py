"""Shipped scenarios of the crankshaft over the kernel's CAN."""

import pytest
from scenario_runs import by_config, run_all, some

pytestmark = pytest.mark.vcan

CONFIGS = by_config("engine")


@pytest.mark.parametrize("config", sorted(CONFIGS))
def test_scenarios_pass_over_vcan(config, tmp_path):
    run_all(config, some(CONFIGS[config]), tmp_path)
