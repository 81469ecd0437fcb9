"""Shipped scenarios of the crankshaft over the kernel's CAN."""

import pytest
from amount import FULL
from scenario_runs import by_config, run_all, some

pytestmark = pytest.mark.vcan

CONFIGS = by_config("crank")


#: The way of its frames is that of one of them, or of CAN FD.
SOME = [config for config in sorted(CONFIGS) if FULL or config.endswith(("gateway.toml", "fd.toml"))]


@pytest.mark.parametrize("config", SOME)
def test_scenarios_pass_over_vcan(config, tmp_path):
    run_all(config, some(CONFIGS[config]), tmp_path)
