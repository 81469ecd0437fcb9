"""The rest bus of a database of others on the kernel's CAN: candump, cantools and python-can are there, too."""

import shutil
import subprocess
from collections import Counter

import can
import numpy as np
import pytest
import warm
from amount import amount
from foreign_project import ROOT, run
from kernel_can import candump, daemon, wait_for
from processes import GATEWAY
from rest_bus_cars import CARS, REQUEST, RESPONSE, Monitor, file_of, load, write

from gateway.bus.frames import payload
from gateway.bus.logs import LogReader

pytestmark = pytest.mark.vcan


#: Over loopback, by processes (tests/system/test_restbus.py), there are others; CAN FD is here only.
HERE = ("vw_mqb", "ford_lincoln_base_pt", "toyota_prius_2010_pt")


@pytest.mark.parametrize("car", HERE[: amount(3, 1)])
def test_a_rest_bus_of_others_and_its_readers(car, tmp_path):
    database = load(car)
    config, scenario, sent, checked = write(tmp_path, car, database)
    _, rising, least = CARS[car]
    assert len(checked) >= least
    log = tmp_path / "all.log"
    monitor = Monitor(file_of(car), ("-i", "socketcan", "-c", "vcan0", "--fd"))
    try:
        with candump("-L", "vcan0", log=log), daemon(config, cwd=tmp_path) as running:
            wait_for(lambda: "Received" in monitor.screen)
            played = warm.Popen(
                [*GATEWAY, "simulate", str(scenario), "--bus", "socketcan:vcan0"],
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            )  # fmt: skip
            answer = None
            mine = [{"can_id": RESPONSE[0], "can_mask": 0x7FF}]
            with can.Bus("vcan0", interface="socketcan", can_filters=mine) as peer:
                while answer is None and played.poll() is None:
                    peer.send(can.Message(arbitration_id=REQUEST[0], data=REQUEST[1], is_extended_id=False))
                    answer = peer.recv(1.0)
            said, _ = played.communicate(timeout=600)
            wait_for(lambda: any(one in monitor.screen for one in checked or sent))
    finally:
        monitor.close()
    assert played.returncode == 0, said
    assert answer is not None, said
    assert bytes(answer.data)[:5] == RESPONSE[1]
    assert running.code == 0
    failed = {event["fault"] for event in running.events() if event["event"] == "dtc" and event["status"] & 1}
    # A busy machine starts the rest bus late, or reads on after it: nobody is heard then.
    assert failed <= {"can.bus_silent"}, "every protected message passes its check"
    frames = np.concatenate(list(LogReader(log)))
    seen, values = Counter(), []
    name, _, signal = (rising or "..").rpartition(".")
    for frame in frames:
        try:
            message = database.get_message_by_frame_id(int(frame["can_id"]) & 0x1FFFFFFF)
        except KeyError:
            continue  # ours, and the tester's
        seen[message.name] += 1
        if message.name == name:
            values.append(message.decode(payload(frame), decode_choices=False)[signal])
    assert set(checked) <= seen.keys() <= set(sent)
    assert min((seen[one] for one in checked), default=50) >= 50
    assert max(seen.values()) >= 50
    if rising is not None:
        assert values == sorted(values)
        assert (values[0], values[-1]) == (pytest.approx(50, abs=2), pytest.approx(100, abs=2))


def test_the_examples_tests_on_the_kernels_can(tmp_path):
    """--gateway-bus: what passes in one process passes here, a loop of a plant and its controller too."""
    folder = tmp_path / "bench"
    shutil.copytree(ROOT / "examples" / "bench", folder, ignore=shutil.ignore_patterns("__pycache__", "left"))
    config = (folder / "gateway.toml").read_text()
    assert "timeout_ms = 200.0" in config
    (folder / "gateway.toml").write_text(config.replace("timeout_ms = 200.0", "timeout_ms = 5000.0"))
    log = tmp_path / "all.log"
    with candump("-L", "vcan0", log=log):
        test = "test_fan.py::test_a_sensor_without_a_value_is_named"
        code, said = run(folder, "--gateway-bus", "socketcan:vcan0", "scenarios/blocked.toml", test)
    assert (code, "2 passed" in said) == (0, True), said
    seen = Counter(line.split()[2].partition("#")[0] for line in log.read_text().splitlines())
    assert min(seen["100"], seen["110"], seen["120"]) > 300, "50 a second, for seconds"
    assert min(seen["7E0"], seen["7E8"]) > 0, "udsoncan and its answers"
