"""The shipped scenarios, each played by this process to a daemon of its own configuration.

What is found in which of them is tested in one process (tests/runtime/test_gateway.py), where time is the frames'. Here
they go over a bus in real time: one of a configuration; with GATEWAY_TESTS=full all of them."""

import re
import time
from pathlib import Path

import pytest
from amount import amount
from kernel_can import daemon

from gateway_bench.cli.simulate import simulate
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import all_shipped, shipped

#: How often a scenario is played, of which a busy machine let too little through in time.
ATTEMPTS = 4


def some(paths, part=1):
    """Return those of one configuration that are played: in CI so many, the shortest in which something is found."""
    known = {path: load_scenario(path) for path in paths}
    telling = [path for path in paths if known[path].expect] or list(paths)
    telling.sort(key=lambda path: known[path].duration_s)
    kept = telling[: amount(len(telling), part)]
    return [path for path in paths if path in kept]


def by_config(ecu):
    """Return the names of the scenarios of a kind of virtual ECU (None: of all), by configuration."""
    found = {}
    for path in all_shipped("scenarios", ".toml"):
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
    copy = folder / Path(config).name
    copy.write_text(text.replace('"diagnostics_faults.toml"', f'"{shipped("configs/diagnostics_faults.toml")}"'))
    return copy


def unhurried(scenario, folder):
    """Return the scenario with later deadlines: what is found is tested here, how soon is in one process.

    DTCs that it does not expect are allowed in the copy: :func:`unexpected` judges them.
    """
    text = scenario.read_text()
    text = re.sub(r"(?m)^by_s = ([0-9.]+)", lambda m: f"by_s = {float(m[1]) + 10:.3f}", text)
    text = re.sub(r"(?m)^healed_by_s = ([0-9.]+)", lambda m: f"healed_by_s = {float(m[1]) + 15:.3f}", text)
    config = load_scenario(scenario).config.resolve()
    text = re.sub(r'(?m)^config = ".*"', f'config = "{config}"', text)
    text = re.sub(r"(?m)^unexpected = .*\n", "", text)
    copy = folder / scenario.name
    copy.write_text('unexpected = "allow"\n' + text)
    return copy


def unexpected(scenario, events):
    """Return the DTCs that were set, and that no line of the scenario expects.

    A missed message is none of them: where all processes of a busy machine stand still, messages are missed. Nor is a
    pedal that jumps: frames that were held back come at once, and it has moved meanwhile.
    """
    expected = {line.dtc for line in load_scenario(scenario).expect if not line.absent}
    failed = {(e["dtc"], e["fault"]) for e in events if e["event"] == "dtc" and e["status"] & 1}
    return {dtc for dtc, fault in failed if not fault.endswith((".timeout", ".jump"))} - expected


def play(config, scenarios, folder):
    """Play scenarios to a daemon, one after the other, as ``gateway simulate --check`` does.

    Returns:
        its events, for each scenario whether it went well, and those that stood still. None: on a busy machine a plant
        stands still, which is none that a monitor knows, or frames miss the few seconds of a fault: it does not count.
        A DTC that nobody expects is wrong in any case.
    """
    verdicts, still = {}, set()
    with (
        daemon(patient(config, folder), cwd=folder) as running,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr("signal.signal", lambda *_: None)  # this process keeps its own
        said: list[str] = []
        patch.setattr("gateway_bench.cli.simulate.say", said.append)
        patch.setattr("gateway_bench.cli.simulate.TOLD_S", 0.0)  # some samples of 10 ms are enough for another plant
        for scenario in scenarios:
            said.clear()
            begun, known = time.monotonic(), len(running.events())
            code = simulate(
                unhurried(scenario, folder), bus="socketcan:vcan0", check=True, wait=60, record=None, seed=None,
                json=False,
            )  # fmt: skip
            print(f"{scenario.stem}: {time.monotonic() - begun:.1f} s", *said, sep="; ")
            verdicts[scenario] = None if code else True
            if any("stood still" in line for line in said):
                still.add(scenario)
            more = unexpected(scenario, running.events()[known:])
            if load_scenario(scenario).unexpected == "fail" and more:
                print(f"{scenario.stem}: not expected: {', '.join(sorted(more))}")
                verdicts[scenario] = None if scenario in still else False
    assert running.code == 0
    assert not [line for line in running.log if "Traceback" in line]
    return running.events(), verdicts, still


def run_all(config, scenarios, folder):
    """Play scenarios; those that do not count again, each time to a new daemon that knows nothing of the last time."""
    left = list(scenarios)
    for attempt in range(ATTEMPTS):
        (folder / str(attempt)).mkdir()
        _, verdicts, _ = play(config, left, folder / str(attempt))
        assert not [path.stem for path, good in verdicts.items() if good is False]
        left = [path for path, good in verdicts.items() if good is None]
        if not left:
            return
    pytest.fail(f"not as expected: {', '.join(path.stem for path in left)}")
