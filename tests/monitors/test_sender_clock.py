"""Clocks of senders: another sender is suspected; queues, losses, host stamps and the receiver's clock are not."""

import numpy as np
import pytest
from car import Car, write
from rest_bus_clocks import bus

from gateway.bus.frames import empty
from gateway_commands.validation import mistakes

COUNT, LEARN_S = 10, 20.0


def gateway(folder, more='code = "U1234"'):
    messages = "".join(f'BO_ {0x100 + m} M{m}: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" B\n' for m in range(COUNT))
    names = ", ".join(f'"M{m}"' for m in range(COUNT))
    monitor = f'[[monitor]]\nname = "c"\ntype = "sender_clock"\nlearn_s = {LEARN_S}\nmessages = [{names}]\n{more}\n'
    return Car(write(folder, messages, monitor))


def feed(car, t, number):
    frames = empty(len(t))
    frames["t_ns"], frames["can_id"], frames["length"] = np.rint((t + 1.0) * 1e9), 0x100 + number, 8
    car.gateway.feed(frames)
    return car


def readout(car):
    return car.gateway.engine.readout()["c"]


@pytest.mark.parametrize("ppm", [-300.0, 300.0])
def test_another_sender_is_suspected_by_name_and_no_other(ppm, tmp_path):
    print("seed 53")
    car = feed(gateway(tmp_path), *bus(np.random.default_rng(53), 80.0, another=(3, 40.0, ppm)))
    assert [e["fault"] for e in car.of("dtc") if e["status"] & 1] == ["c.sender"]
    assert readout(car)["suspicions"] == 1
    assert readout(car)["suspected"] == 4, "counted from 1"
    assert readout(car)["steady"] == COUNT


def test_healthy_senders_are_not_though_the_receivers_clock_is_slewed(tmp_path):
    print("seed 54")
    slewed = bus(np.random.default_rng(54), 120.0, receiver_ppm=lambda t: 430.0 if 50 <= t < 80 else -70.0)
    car = feed(gateway(tmp_path), *slewed)
    assert car.of("dtc") == []
    assert readout(car)["suspicions"] == 0
    assert readout(car)["steady"] > COUNT // 2, "or the test shows nothing"


def test_pauses_and_a_sender_that_starts_again_are_no_suspicion(tmp_path):
    print("seed 55")
    t, number = bus(np.random.default_rng(55), 100.0)
    again = np.where((number == 2) & (t > 60.0), t + 0.0037, t)  # it was reset: another phase, the same clock
    kept = ~((number == 2) & (t > 57.0) & (t < 60.0)) & ~((t > 70.0) & (t < 75.0))
    order = np.argsort(again[kept], kind="stable")
    car = feed(gateway(tmp_path), again[kept][order], number[kept][order])
    assert readout(car)["suspicions"] == 0


def test_without_a_code_it_is_told_in_the_log_alone(tmp_path, capsys):
    print("seed 53")
    car = feed(gateway(tmp_path, ""), *bus(np.random.default_rng(53), 80.0, another=(3, 40.0, 300.0)))
    assert readout(car)["suspicions"] == 1
    assert car.of("dtc") == []
    assert not [slot for slot in car.gateway.engine.faults if slot.id.startswith("c.")]
    car.gateway.stop(car.gateway.engine.now_ns)
    assert "message=M3" in "".join(capsys.readouterr())


def test_mistakes_are_told_in_one_line(tmp_path):
    path = tmp_path / "gateway.toml"
    gateway(tmp_path)
    path.write_text(path.read_text().replace('"M1"', '"M0"'))
    (found,) = mistakes(path)
    assert "M0 is there twice" in str(found)
