"""A shipped scenario of the hybrid truck over the kernel's CAN."""

import pytest
from scenario_runs import by_config, run_all

pytestmark = pytest.mark.vcan

#: The others are the same over a bus; 30 s of one of them is enough of a slow kernel's time.
CONFIG, SCENARIOS = next(
    (config, paths) for config, paths in by_config("truck").items() if config.endswith("truck.toml")
)


@pytest.mark.full("the crankshaft's go the same way over the bus")
def test_a_fault_is_named_over_can(tmp_path):
    run_all(CONFIG, [path for path in SCENARIOS if "battery" in str(path)], tmp_path)
