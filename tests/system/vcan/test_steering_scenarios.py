"""Shipped scenarios of the steering over the kernel's CAN, each with a daemon of its own."""

import pytest
from scenario_runs import by_config, play, run_all

pytestmark = pytest.mark.vcan

((CONFIG, SCENARIOS),) = by_config("steering").items()
HEALTHY, PARTS = (next(p for p in SCENARIOS if p.stem == f"steering_{x}") for x in ("healthy", "parts"))


@pytest.mark.full("of the healthy ones one is enough")
def test_a_healthy_steering_over_vcan(tmp_path):
    run_all(CONFIG, [HEALTHY], tmp_path)


@pytest.mark.full("the crankshaft's go the same way over the bus")
def test_its_parts_over_vcan(tmp_path):
    """Nothing is found that is not there, and something that is.

    What compares angles is not tested while senders stand still for tens of ms, as they do in the kernel of a busy
    machine. In one process, and with pauses of a known length, all are asked for (tests/runtime/test_gateway.py,
    tests/steering/monitor/test_pauses.py), as are those of ``steering_angle``, which need a second of even
    milliseconds in between. Where the scenario stood still its plant stood still, too, which no steering does while
    time goes on: that run shows only that the daemon goes on, and it is played again to one that knows nothing.
    """
    parts = {"C1A02-64", "C1A03-64", "C1A04-62", "C1A05-64", "C1A06-64", "C1A08-82"}
    for attempt in range(2):
        (tmp_path / str(attempt)).mkdir()
        events, _, still = play(CONFIG, [PARTS], tmp_path / str(attempt))
        failed = {e["dtc"] for e in events if e["event"] == "dtc" and e["status"] & 1}
        failed = {dtc for dtc in failed if dtc[0] != "U"}  # at the end nobody sends any more
        if not still:
            assert failed
            assert failed <= parts
            return
    print("this machine stood still in each run: of the steering's parts nothing is shown here")
