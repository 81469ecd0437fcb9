"""What was chosen once is found again: without algebra, and only for the same model, question and generator."""

import json
import os
import subprocess
import sys
from dataclasses import asdict

import pytest
from amount import amount
from structural_config import configuration

from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import cache, cache_directory
from gateway_plants.structural.monitor import plan_cache
from gateway_plants.structural.monitor.plan import from_dict

MOTOR = shipped("models/motor.toml").read_bytes()

#: Prints whether algebra and the integer program were loaded, when the configuration was.
LOADS = """
import sys
from pathlib import Path
from gateway.common.lazy_modules import postpone
postpone()
from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
monitor, params = monitor_of(load_config(Path(sys.argv[1])).monitor[0])
print(len(monitor.notes(params)), "sympy" in sys.modules, "scipy.optimize" in sys.modules)
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache of one's own."""
    monkeypatch.setenv("GATEWAY_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache" / "kernels"


def heard(monkeypatch):
    said = []
    monkeypatch.setattr(cache.progress, "say", said.append)
    monkeypatch.setattr(cache, "_said", set())
    return said


def loads(path):
    done = subprocess.run([sys.executable, "-c", LOADS, str(path)], capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.long
def test_a_warm_start_loads_no_algebra(tmp_path, folder):
    path = configuration(tmp_path)
    assert loads(path) == ["8", "True", "True"]
    assert len(list(folder.glob("plan-*.json"))) == 1
    assert loads(path) == ["8", "False", "False"]


@pytest.mark.long
def test_what_is_damaged_is_made_again(tmp_path, folder):
    path = configuration(tmp_path)
    loads(path)
    (file,) = folder.glob("plan-*.json")
    whole = file.read_bytes()
    for damaged in (whole[:-100], whole.replace(b"kernel", b"kernal", 1), b"")[: amount(3, 2)]:
        file.write_bytes(damaged)
        assert loads(path) == ["8", "True", "True"]
        assert file.read_bytes() == whole


def test_the_key_is_all_that_it_is_made_of(monkeypatch):
    asked = {"tests": "auto", "causality": "integral"}
    keys = {
        plan_cache.key_of(MOTOR, asked),
        plan_cache.key_of(MOTOR + b"\n", asked),
        plan_cache.key_of(MOTOR, asked | {"causality": "mixed"}),
    }
    monkeypatch.setattr(plan_cache, "_generator", lambda: "another")
    keys.add(plan_cache.key_of(MOTOR, asked))
    assert len(keys) == 4


def test_a_plan_is_the_same_after_json(tmp_path, folder):
    configuration(tmp_path)
    kept_plan = _plan(tmp_path)
    assert from_dict(json.loads(json.dumps(asdict(kept_plan)))) == kept_plan
    assert plan_cache.read("nothing") is None
    plan_cache.write("some", kept_plan)
    assert plan_cache.read("some") == kept_plan


def _plan(tmp_path):
    from gateway_fdi.structure.file import load_model
    from gateway_plants.structural.monitor.choice import choose

    params = monitor_of(load_config(tmp_path / "gateway.toml").monitor[0])[1]
    return choose(load_model(shipped("models/motor.toml")), params)


def test_a_plan_that_another_could_have_written_is_not_run(tmp_path, folder, monkeypatch):
    said = heard(monkeypatch)
    configuration(tmp_path)
    plan = _plan(tmp_path)
    plan_cache.write("some", plan)
    assert plan_cache.read("some") == plan
    (file,) = cache_directory().glob("plan-some.json")
    file.chmod(0o666)
    assert plan_cache.read("some") is None
    assert any(str(file) in line for line in said)
    plan_cache.write("some", plan)
    file.parent.chmod(0o777)
    assert plan_cache.read("some") is None
    if os.geteuid() == 0:
        file.parent.chmod(0o755)
        os.chown(file, 65534, -1)
        assert plan_cache.read("some") is None


def test_a_folder_that_cannot_be_written_costs_time_only(tmp_path, folder, monkeypatch):
    said = heard(monkeypatch)
    cache_directory().parent.mkdir(parents=True, exist_ok=True)
    cache_directory().write_text("a file where the folder belongs")
    configuration(tmp_path)
    plan_cache.write("some", _plan(tmp_path))
    assert any("cannot be kept" in line for line in said)
