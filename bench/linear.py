"""Time of a sample of the paper's plant through the bank of PI observers, beside NumPy, in one run.

python bench/linear.py [--steps 200000] [--json]
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
from gateway_plants.linear.monitor import plant as linear_plant
from gateway_plants.linear.pi_bank import bank
from gateway_plants.linear.pi_bank.design import augmented
from gateway_plants.linear.study import example
from gateway_plants.linear.study.bank import drive, observers

REPEATS = 5


@kernel
def run_bank(s, c, y, u):
    """The paper's three observers, its products of flags."""
    raised = 0
    for t in range(y.shape[0]):
        for k in range(1, 4):
            bank.innovate(s, c, k, y[t])
        for i in range(2):
            small = 0
            for k in range(1, 4):
                small += 1 if abs(s.z[k, 4 + i]) < 0.01 else 0
            raised += 1 if small == 0 else 0
        for j in range(3):
            small = 0
            for k in range(1, 4):
                small += 1 if k != j + 1 and abs(s.e[k, j]) < 0.1 else 0
            raised += 1 if small == 0 else 0
        for k in range(1, 4):
            bank.advance(s, c, k, u[t])
    return raised


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
    """The same three observers in NumPy."""
    phi, plant = augmented(example.plant()), example.plant()
    gamma = np.vstack([plant.gamma, np.zeros((2, 2))])
    rows = [[j for j in range(3) if j != k] for k in range(3)]
    left = [np.hstack([plant.c[r], np.zeros((2, 2))]) for r in rows]
    gains = [observer.gain.gain for observer in observers()[1:]]
    z = [np.zeros(6) for _ in range(3)]
    begun = time.perf_counter()
    for t in range(len(y)):
        flags = np.ones(2, bool)
        least = np.full(3, np.inf)
        for k in range(3):
            e = y[t][rows[k]] - left[k] @ z[k]
            flags &= np.abs(z[k][4:]) >= 0.01
            least[rows[k]] = np.minimum(least[rows[k]], np.abs(e))
            z[k] = phi @ z[k] + gamma @ u[t] + gains[k] @ e
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
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rng = np.random.default_rng(1)
    y, u = simulate(drive(0.01, stable=True), (), 1000.0, rng)
    repeats = max(options.steps // len(y), 1)
    many_y, many_u = np.tile(y, (repeats, 1)), np.tile(u, (repeats, 1))
    s, c = zeros(1, bank.State)[0], zeros(1, bank.Const)[0]
    bank.prepare(c, example.plant(), observers())
    run_bank(s, c, y, u)
    times = {
        "NumPy, three observers, flags": numpy_us(y[:3000], u[:3000]),
        "the paper's bank, replay": best_us(lambda: run_bank(s, c, many_y, many_u), len(many_y)),
        "monitor with our decisions": monitor_us(y, u, logic="jumps"),
        "monitor with model_error of 5 %": monitor_us(y, u, model_error=0.05),
        "whole gateway, a frame": gateway_us(),
    }
    peer = times["NumPy, three observers, flags"]
    rows = [{"name": name, "us": us, "ratio": peer / us, "against": "NumPy"} for name, us in times.items()]
    if options.json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        print(f"{row['name']:36s} {row['us']:9.4f} us a step  {row['ratio']:9.1f} x NumPy")


if __name__ == "__main__":
    main()
