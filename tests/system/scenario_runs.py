"""The shipped scenarios, each played by this process to a daemon of its own configuration."""

import re
import time
from pathlib import Path

import pytest
from kernel_can import daemon

from gateway.cli.simulate import simulate
from gateway.resources import shipped
from gateway.vecu.scenario import load_scenario


def by_config(ecu):
    """Return the names of the scenarios of a kind of virtual ECU (None: of all), by configuration."""
    found = {}
    for path in sorted(shipped("scenarios").glob("*.toml")):
        scenario = load_scenario(path)
        if ecu is None or {entry.type for entry in scenario.ecu} == {ecu}:
            found.setdefault(str(scenario.config.resolve()), []).append(path)
    for paths in found.values():
        # Frames out of order leave the crankshaft monitor with a learned wheel that makes the ECU's next start look
        # like a missing gap: that drive is the last of its daemon.
        paths.sort(key=lambda path: (path.stem == "crank_wire_late", path.stem))
    return found


def patient(config, folder):
    """Return the configuration with longer timeouts: on a shared machine a process may get no turn for a while."""
    text = re.sub(r"timeout_ms = 100\.0", "timeout_ms = 1000.0", Path(config).read_text())
    for name in ("dbc", "configs"):
        text = text.replace(f'"../{name}/', f'"{shipped(name)}/').replace(
            f'"{name}/', f'"{shipped(name)}/'
        )
    copy = folder / Path(config).name
    copy.write_text(
        text.replace('"diagnostics_faults.toml"', f'"{shipped("configs")}/diagnostics_faults.toml"')
    )
    return copy


def unhurried(scenario, folder):
    """Return the scenario with later deadlines: what is found is tested here, how soon is in one process."""
    text = scenario.read_text()
    text = re.sub(r"(?m)^by_s = ([0-9.]+)", lambda m: f"by_s = {float(m[1]) + 0.6:.3f}", text)
    text = re.sub(
        r"(?m)^healed_by_s = ([0-9.]+)", lambda m: f"healed_by_s = {float(m[1]) + 1.5:.3f}", text
    )
    text = re.sub(
        r'(?m)^config = "(.*)"', lambda m: f'config = "{(scenario.parent / m[1]).resolve()}"', text
    )
    copy = folder / scenario.name
    copy.write_text(text)
    return copy


def run_all(config, scenarios, folder, *, strict=True):
    """Play scenarios to one daemon, one after the other, as ``gateway simulate --check`` does; returns its events."""
    with (
        daemon(patient(config, folder), cwd=folder) as running,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr("signal.signal", lambda *_: None)  # this process keeps its own
        failed = []
        for scenario in scenarios:
            begun = time.monotonic()
            code = simulate(
                unhurried(scenario, folder), bus="socketcan:vcan0", check=True, wait=60, record=None, seed=None,
                json=False,
            )  # fmt: skip
            print(f"{scenario.stem}: {time.monotonic() - begun:.1f} s")
            if code:
                failed.append(scenario.stem)
    assert running.code == 0
    assert not [line for line in running.log if "Traceback" in line]
    if strict:
        assert not failed
    return running.events()
