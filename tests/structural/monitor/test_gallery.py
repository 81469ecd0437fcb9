"""The gallery: plants from equations alone, their faults named as their scenarios say, healthy drives quiet."""

import subprocess
import sys

import pytest
from amount import FULL, amount

from bench.battery_pack import battery_model
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import COMPILED
from gateway_fdi.structure.file import load_model
from gateway_plants.structural.study import gallery

pytestmark = [pytest.mark.long, pytest.mark.skipif(not COMPILED, reason="tens of thousands of samples")]

#: In CI one: each plant has a kernel of its own, which takes 5 to 10 s to compile; test_gateway.py plays the others.
PLANTS = sorted(gallery.PLANTS if FULL else ["motor"])
CASES = [(plant, k) for plant in PLANTS for k in range(len(list(gallery.cases(plant))))]
#: 10 h in the full size, in drives of an hour.
HEALTHY_S = {"motor": 60.0, "tanks": 3600.0, "cooling": 3600.0, "battery": 600.0, "brake": 30.0}


@pytest.mark.parametrize(("plant", "k"), CASES, ids=[f"{p}-{k}" for p, k in CASES])
def test_each_fault_has_its_name(plant, k):
    """Of seeds that nothing was chosen by: its DTC first, and nothing before the fault."""
    case = list(gallery.cases(plant))[k]
    for seed in range(400, 400 + amount(20, 1)):
        found = gallery.run(plant, case, seed)
        assert (found.before, found.dtcs[:1]) == ((), (case.dtc,)), (case.fault.name, seed, found)


@pytest.mark.parametrize("plant", PLANTS)
def test_healthy_drives_are_quiet(plant):
    for seed in range(500, 510 if FULL else 501):
        seconds = 3600.0 if FULL else HEALTHY_S[plant]
        assert gallery.dtcs(plant, gallery.frames(plant, seed, seconds)) == [], seed


def test_the_pack_s_model_is_the_generator_s(tmp_path):
    assert shipped("models/battery.toml").read_text() == battery_model(4)
    (tmp_path / "pack.toml").write_text(battery_model(16))
    model = load_model(tmp_path / "pack.toml")
    assert (len(model.equations), len(model.residuals), len(model.faults)) == (51, 33, 34)


@pytest.mark.full("the same plants and faults, one after the other")
@pytest.mark.parametrize("plant", gallery.PLANTS)
def test_the_shipped_scenarios(plant):
    ended = subprocess.run(
        [sys.executable, "-c", "from gateway.cli import main; main()",
         "simulate", f"{plant}_faults", "--bus", "inside", "--check"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout[-2000:]
