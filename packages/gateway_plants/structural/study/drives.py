"""Drives of the foreign plants, solved by SciPy; their frames; what a gateway says of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gateway.bus.frames import Frames, empty
from gateway.bus.logs import open_writer
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.faults.status import Status
from gateway.runtime.app import Gateway
from gateway_calibration.cusum import learn
from gateway_calibration.file import write
from gateway_calibration.logs import Reading
from gateway_plants.structural.study.foreign import Array, Numbers, Plant

#: Time of the first frame [ns].
BEGIN = 10**9


def _linear(plant: Plant, u: Array, p: Numbers, x: Array, begin: float, times: Array) -> Array:
    """Return the states at equidistant times of a stretch of linear slopes, and at its end, by exponentials."""
    from scipy.linalg import expm  # noqa: PLC0415 - slow to load

    n = len(x)
    block = np.zeros((n + 1, n + 1))
    block[:n, n] = plant.slopes(np.zeros(n), u, p)
    block[:n, :n] = np.array([plant.slopes(e, u, p) for e in np.eye(n)]).T - block[:n, n:]
    power, x1 = expm(block * plant.period_s), np.append(x, 1.0)
    found = (x1 if times[0] == begin else expm(block * (times[0] - begin)) @ x1)[:, None]
    while found.shape[1] < len(times) - 1:
        found = np.hstack([found, power @ found])
        power = power @ power
    found = found[:, : len(times) - 1]
    last, since = (found[:, -1], times[-2]) if len(times) > 1 else (x1, begin)
    end = expm(block * (times[-1] - since)) @ last
    return np.vstack([found.T, end])[:, :n]


def _solved(plant: Plant, u: Array, p: Numbers, x: Array, begin: float, times: Array) -> Array:
    """Return the states at some times of a stretch, the last of them its end, by LSODA."""
    from scipy.integrate import solve_ivp  # noqa: PLC0415 - slow to load

    def slopes(_: float, x: Array) -> Array:
        return np.asarray(plant.slopes(x, u, p))

    found = solve_ivp(slopes, (begin, times[-1]), x, "LSODA", times, rtol=1e-8, atol=1e-10)
    return np.asarray(found.y.T)


def run(
    plant: Plant, seconds: float, seed: int, fault: str = "", onset: float = 0.0, p: Numbers | None = None
) -> Array:
    """Return what the signals are at each sample, shape (samples, knowns).

    Args:
        seconds: length [s].
        seed: of commands and noise.
        fault: that is there from ``onset`` on [s]; empty: none.
        onset: of the fault.
        p: the plant's parameters; None: as the model has them.
    """
    rng = np.random.default_rng(seed)
    healthy = dict(plant.p if p is None else p)
    faulty = healthy | {
        key: value / plant.p[key] * healthy[key] if plant.p[key] else value
        for key, value in (plant.faults[fault].items() if fault else ())
    }
    at, u = plant.commands(rng, seconds)
    times = np.arange(round(seconds / plant.period_s)) * plant.period_s
    x, begin, rows = np.array(plant.begin(healthy)), 0.0, []
    for end in sorted({*at.tolist(), onset, seconds} - {0.0}):
        told = u[np.searchsorted(at, begin, side="right") - 1]
        now = faulty if fault and begin >= onset else healthy
        inside = times[(times >= begin - 1e-9) & (times < end - 1e-9)]
        states = (_linear if plant.linear else _solved)(plant, told, now, x, begin, np.append(inside, end))
        rows.append(np.stack(np.broadcast_arrays(*plant.measured(states[:-1].T, told, now)), 1))
        x, begin = states[-1], end
    found = np.concatenate(rows)
    return np.asarray(found + rng.normal(size=found.shape) * np.array(plant.noise))


def off(plant: Plant, share: float, seed: int) -> dict[str, float]:
    """Return parameters of which each uncertain one is ``share`` more or less than the model says."""
    rng = np.random.default_rng([seed, 1])
    return {**plant.p, **{key: plant.p[key] * (1 + share * rng.choice([-1, 1])) for key in plant.uncertain}}


def as_bought(plant: Plant, rows: Array, seed: int) -> Array:
    """Return readings of sensors whose gains are off by 0.5 %, with half the bias that their data sheets allow."""
    rng = np.random.default_rng([seed, 2])
    bias = np.array(plant.bias) * rng.choice([-1, 1], len(plant.bias))
    gain = 0.005 * np.sign(plant.bias) * rng.choice([-1, 1], len(plant.bias))
    return np.asarray(rows * (1 + gain) + bias)


def frames_of(plant: Plant, rows: Array, late_s: Mapping[str, float] | None = None, waits_s: float = 0.0) -> Frames:
    """Return the frames of samples, one float signal each, in order of time.

    Args:
        rows: what is read, shape (samples, knowns).
        late_s: by how much the frames of some known variables come later than they were read [s].
        waits_s: mean of an exponential waiting of each frame, which overtakes none of its own message [s].
    """
    count, width = rows.shape
    rng = np.random.default_rng(count)
    frames = empty(count * width)
    for k, z in enumerate(plant.knowns):
        mine = frames[k * count : (k + 1) * count]
        at = np.arange(count) * plant.period_s + (late_s or {}).get(z, 0.0) + k * 1e-6
        if waits_s:
            at = np.maximum.accumulate(at + rng.exponential(waits_s, count))
        mine["t_ns"] = BEGIN + np.round(at * 1e9).astype(np.int64)
        mine["can_id"], mine["length"] = 256 + k, 4
        mine["data"][:, :4] = rows[:, k].astype("<f4").view(np.uint8).reshape(count, 4)
    return frames[np.argsort(frames["t_ns"], kind="stable")]


def configuration(plant: Plant, folder: Path, more: str = "") -> Path:
    """Write what a user would: model, database, configuration; returns the configuration."""
    (folder / f"{plant.name}.toml").write_text(plant.model)
    messages = "".join(
        f'BO_ {256 + k} M{k}: 4 A\n SG_ {z} : 0|32@1- (1,0) [0|0] "" A\n' for k, z in enumerate(plant.knowns)
    )
    kinds = "".join(f"SIG_VALTYPE_ {256 + k} {z} : 1;\n" for k, z in enumerate(plant.knowns))
    (folder / "plant.dbc").write_text(f'VERSION ""\nNS_ :\nBS_:\nBU_: A\n{messages}{kinds}')
    signals = ", ".join(f'{z} = "M{k}.{z}"' for k, z in enumerate(plant.knowns))
    sample = "" if "sample =" in more else 'sample = "set"\n'
    path = folder / "gateway.toml"
    path.write_text(
        '[clock]\nwatched = false\n[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["plant.dbc"]\n'
        'health = { watched = false }\n[memory]\npath = "faults.sqlite"\n'
        f'[[monitor]]\nname = "own"\ntype = "structural"\nmodel = "{plant.name}.toml"\n{sample}'
        f"period_ms = {plant.period_s * 1e3:g}\n{plant.options}{more}signals = {{ {signals} }}\n"
    )
    return path


def calibrated(config: Path, *frames: Frames) -> None:
    """Calibrate a configuration by healthy drives."""
    logs = [config.with_name(f"healthy_{k}.log") for k in range(len(frames))]
    for path, each in zip(logs, frames, strict=True):
        writer = open_writer(path)
        writer.write(each)
        writer.close()
    write(config, learn(load_config(config), logs, Reading(config)).tables, "healthy logs")
    for path in logs:
        path.unlink()


def told_as(config: Config, file: Path, fault: str) -> str:
    """Return the name that a fault has when all its tests have fired: its own, or with those that they cannot tell."""
    gateway = Gateway(config, None, file=file)
    own = gateway.engine.monitors[0]
    names: list[str] = [one.name for one in own.monitor.faults(own.params)]
    gateway.close()
    return min((name for name in names if fault in name.split("_or_")), key=lambda name: name.count("_or_"))


def heard(gateway: Gateway) -> list[Mapping[str, object]]:
    """Return the events of the DTCs that fail from now on: a list that grows."""
    found: list[Mapping[str, object]] = []

    def listen(event: Mapping[str, object]) -> None:
        if event["event"] == "dtc" and int(str(event["status"])) & Status.TEST_FAILED:
            found.append(event)

    gateway.listen(listen)
    return found


def codes(config: Config, file: Path, frames: Frames) -> list[tuple[float, str]]:
    """Return the faults whose DTCs a drive sets, with their times [s]."""
    gateway = Gateway(config, None, file=file)
    told = heard(gateway)
    gateway.start(int(frames[0]["t_ns"]))
    gateway.feed(frames)
    gateway.close()
    return [((int(str(one["t_ns"])) - BEGIN) * 1e-9, str(one["fault"]).partition(".")[2]) for one in told]
