"""Every shipped scenario of the steering over the kernel's CAN."""

import pytest
from scenario_runs import by_config, run_all

pytestmark = pytest.mark.vcan

CONFIGS = by_config("steering")


@pytest.mark.parametrize("config", sorted(CONFIGS))
def test_scenarios_pass_over_vcan(config, tmp_path):
    run_all(config, CONFIGS[config], tmp_path)
