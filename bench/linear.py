"""Time of a sample of the paper's plant through the bank of PI observers, beside NumPy, in one run.

python bench/linear.py [--json]
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway.runtime.app import Gateway
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import call_entry, kernel, zeros
from gateway_plants.linear.ecu.plant import simulate
from gateway_plants.linear.mathematics.gains import from_noise
from gateway_plants.linear.monitor import plant as linear_plant
from gateway_plants.linear.study import example
from gateway_plants.linear.study.bank import drive, noise

REPEATS = 5


@kernel
def call(entry, state, const, inputs, stride, count, out, results):
    """Call a monitor through its address for one sample after the other, as the engine does with live frames."""
    for t in range(count):
        results.n = 0  # taken, as the engine does
        call_entry(entry, state, const, inputs + t * stride, out)


def monitor_us(y, u, **keys):
    """A monitor's step, one call a sample [us]; ``keys``: of its table."""
    found = load_config(shipped("configs/linear_aircraft.toml")).monitor[0]
    monitor, p = monitor_of(found)
    p = type(p).model_validate({**p.model_dump(), **keys})
    state, const, out = zeros(1, monitor.state), zeros(1, monitor.const), zeros(1, monitor.results)
    monitor.prepare(p, state[0], const[0])
    rows = zeros(len(y), monitor.inputs)
    rows["y"][:, :3], rows["u"][:, :2] = y, u
    rows["t_ns"], rows["which"], rows["gap"] = np.arange(len(y)) * 100_000_000, linear_plant.OUTPUTS, 1
    addresses = (state.ctypes.data, const.ctypes.data, rows.ctypes.data, rows.itemsize)

    def work():
        call(monitor.entry, *addresses, len(y), out.ctypes.data, out[0])

    work()
    return best_us(work, len(y))


def best_us(work, count):
    best = np.inf
    for _ in range(REPEATS):
        begun = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - begun)
    return best / count * 1e6


def numpy_us(y, u):
    """One stationary Kalman filter in NumPy."""
    plant, told = example.plant(), noise()
    q = np.diag(told.states**2 * plant.period)
    gain = from_noise(plant.phi, plant.c, q, np.diag(told.outputs**2)).gain
    x = np.zeros(plant.states)
    begun = time.perf_counter()
    for t in range(len(y)):
        x = plant.phi @ x + plant.gamma @ u[t] + gain @ (y[t] - plant.c @ x)
    return (time.perf_counter() - begun) / len(y) * 1e6


def gateway_us():
    """The whole way of a frame of the bus: decode, counter, CRC, monitor [us]."""
    scenario = load_scenario(shipped("scenarios/linear_aircraft_healthy.toml"))
    config = load_config(scenario.config)
    frames = Player(scenario, {"flight": 0}).frames
    best = np.inf
    for _ in range(REPEATS):
        gateway = Gateway(config)
        gateway.start(0)
        begun = time.perf_counter()
        gateway.feed(frames)
        best = min(best, time.perf_counter() - begun)
        gateway.close()
    return best / len(frames) * 1e6


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rng = np.random.default_rng(1)
    y, u = simulate(drive(0.01, stable=True), (), 1000.0, rng)
    times = {
        "NumPy, one filter": numpy_us(y[:3000], u[:3000]),
        "monitor of an exact plant": monitor_us(y, u),
        "monitor with model_error of 5 %": monitor_us(y, u, model_error=0.05),
        "whole gateway, a frame": gateway_us(),
    }
    peer = times["NumPy, one filter"]
    rows = [{"name": name, "us": us, "ratio": peer / us, "against": "NumPy"} for name, us in times.items()]
    if options.json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        print(f"{row['name']:36s} {row['us']:9.4f} us a step  {row['ratio']:9.1f} x NumPy")


if __name__ == "__main__":
    main()
