"""Shipped scenarios of the brake pedal over the kernel's CAN."""

import pytest
from amount import amount
from scenario_runs import by_config, run_all, some

pytestmark = pytest.mark.vcan

CONFIGS = by_config("pedal")


@pytest.mark.full("the crankshaft's go the same way over the bus")
@pytest.mark.parametrize("config", sorted(CONFIGS)[: amount(9, 1)])
def test_scenarios_pass_over_vcan(config, tmp_path):
    run_all(config, some(CONFIGS[config]), tmp_path)
