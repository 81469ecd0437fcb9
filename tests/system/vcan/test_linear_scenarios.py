"""A shipped scenario of a linear plant over the kernel's CAN."""

import pytest
from scenario_runs import by_config, run_all, some

pytestmark = pytest.mark.vcan

#: Those of the aircraft fly for minutes, in real time; in one process they run in tests/runtime/test_gateway.py.
BELT = {config: paths for config, paths in by_config("linear").items() if "belt" in config}


@pytest.mark.full("its frames have to come evenly for 40 s, which a busy machine does not do")
@pytest.mark.parametrize("config", sorted(BELT))
def test_scenarios_pass_over_vcan(config, tmp_path):
    run_all(config, some(BELT[config]), tmp_path)
