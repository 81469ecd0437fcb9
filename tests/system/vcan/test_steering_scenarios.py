"""Every shipped scenario of the steering over the kernel's CAN, each with a daemon of its own."""

import pytest
from scenario_runs import by_config, run_all

pytestmark = pytest.mark.vcan

RUNS = [(config, path) for config, paths in by_config("steering").items() for path in paths]


@pytest.mark.parametrize(("config", "scenario"), RUNS, ids=lambda value: getattr(value, "stem", ""))
def test_scenarios_pass_over_vcan(config, scenario, tmp_path):
    run_all(config, [scenario], tmp_path)
