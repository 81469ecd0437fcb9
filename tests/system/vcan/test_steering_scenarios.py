"""Shipped scenarios of the steering over the kernel's CAN, each with a daemon of its own."""

import pytest
from scenario_runs import by_config, run_all

pytestmark = pytest.mark.vcan

#: Its five faults heal between each other only if frames keep their millisecond for a second each time; the test kernel
#: of a busy machine does not. In one process, live and replayed, it runs in tests/test_gateway.py.
NEEDS_THE_PACE = {"steering_angle"}
RUNS = [
    (config, path)
    for config, paths in by_config("steering").items()
    for path in paths
    if path.stem not in NEEDS_THE_PACE
]


@pytest.mark.parametrize(("config", "scenario"), RUNS, ids=lambda value: getattr(value, "stem", ""))
def test_scenarios_pass_over_vcan(config, scenario, tmp_path):
    run_all(config, [scenario], tmp_path)
