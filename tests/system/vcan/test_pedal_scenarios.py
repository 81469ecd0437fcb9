"""Shipped scenarios of the brake pedal over the kernel's CAN."""

import pytest
from amount import amount
from scenario_runs import by_config, run_all, some

pytestmark = pytest.mark.vcan

CONFIGS = by_config("pedal")


@pytest.mark.parametrize("config", sorted(CONFIGS)[: amount(9, 1)])
def test_scenarios_pass_over_vcan(config, tmp_path):
    run_all(config, some(CONFIGS[config]), tmp_path)


def test_no_scenario_is_left_out():
    every = {**by_config("crank"), **CONFIGS, **by_config("steering"), **by_config("linear")}
    every |= by_config("truck")
    for config, paths in (
        item for ecu in ("responder", "restbus", "structural", "table", "turbo") for item in by_config(ecu).items()
    ):
        every[config] = [*every.get(config, ()), *paths]  # in one process: tests/test_gateway.py
    assert every == by_config(None)
    assert sum(map(len, every.values())) >= 21
