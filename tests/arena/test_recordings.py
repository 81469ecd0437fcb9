"""Plants that are not ours: recordings in LiU-ICE's format, made here; the Tennessee Eastman process."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from gateway.cli import app
from gateway_arena.contract import SAMPLES, NotForThisPlantError
from gateway_arena.plants import plant
from gateway_arena.plants.engine import COLUMNS, Engine
from gateway_fdi.errors import InputError

SEED = 3
#: Columns of the published files come in an order of their own, with more than is asked for.
HEADER = ["time", "ambient_pressure", *[name for name in COLUMNS.values() if name != "ambient_pressure"], "extra"]


def write(file, minutes, seed, factor=1.0):
    """Write a drive: signals that follow a load, each with noise; the intercooler's pressure is off from 120 s on."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0 * minutes, 0.05)
    load = np.convolve(rng.normal(size=len(t) + 199), np.ones(200) / 200, "valid")
    values = 10.0 + load[:, None] + rng.normal(0.0, 0.01, (len(t), len(HEADER) - 1))
    values[t >= 120.0, HEADER.index("intercooler_pressure") - 1] *= factor
    lines = [",".join(f"{x:.6g}" for x in row) for row in np.column_stack([t, values])]
    file.write_text("\n".join([",".join(HEADER).upper(), *lines]) + "\n")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("liu")
    print("seed", SEED)
    write(place / "wltp_NF.csv", 16, SEED)
    for k, name in enumerate(("wltp_f_pic_090", "wltp_f_pic_110")):
        write(place / f"{name}.csv", 4, SEED + 1 + k, (0.9, 1.1)[k])
    (place / "notes.csv").write_text("not of the benchmark")
    return place


def test_records_are_cut_at_the_fault(folder):
    engine = Engine(folder)
    given = engine.records()
    assert dict(engine.sizes) == {"f_pic": "wltp_f_pic_090.csv, wltp_f_pic_110.csv"}
    assert (len(given.learned), len(given.validated), len(given.healthy), len(given.faulty)) == (5, 11, 4, 2)
    bad = given.faulty[0]
    ratio = bad.values[:, 0] / bad.values[:, 1]
    assert ratio[: bad.onset].mean() == pytest.approx(1.0, abs=1e-3)
    assert ratio[bad.onset :].mean() == pytest.approx(0.9, abs=1e-3)
    assert ratio[bad.onset] < 0.95 < ratio[bad.onset - 1], "not a sample late"
    with pytest.raises(NotForThisPlantError):
        engine.dynamics(np.zeros(0))


@pytest.mark.long
def test_one_command_judges_a_folder(folder):
    options = ["--data", str(folder), "--false-alarm", "0.1", "--json"]
    for name in ("pca", "forest", "structural"):
        options += ["--method", name]
    said = CliRunner().invoke(app, ["evaluate", "arena", *options])
    assert said.exit_code == 0, said.output
    pca, forest, structural = json.loads(said.stdout)["rows"]
    assert (pca["plant"], pca["runs"], pca["detected"], pca["healthy"]) == ("liu_ice", 2, 2, 4)
    assert "too few records" in forest["refused"]
    assert "no equation" in structural["refused"]
    few = CliRunner().invoke(app, ["evaluate", "arena", "--data", str(folder), "--method", "pca"])
    assert "19 healthy records" in str(few.exception)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("AIR_MASS_FLOW", "AIR", "no such column"),
        ("\n0.05,", "\n0.05,nan,", "numbers|no number"),
        ("\n0.1,", "\n0.4,", "samples are 0.05 s apart"),
    ],
)
def test_a_file_that_is_wrong_is_named(folder, tmp_path, old, new, why):
    text = (folder / "wltp_f_pic_090.csv").read_text()
    assert old in text
    (tmp_path / "wltp_NF.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=why) as found:
        Engine(tmp_path)
    assert str(tmp_path / "wltp_NF.csv") in str(found.value)


def test_a_folder_without_the_files_is_refused(tmp_path):
    with pytest.raises(InputError, match="wltp_NF"):
        Engine(tmp_path)


def test_tennessee_begins_its_fault_at_its_onset():
    pytest.importorskip("tep_studio", reason="pip install tep-studio: the Tennessee Eastman process")
    made = plant("tennessee")
    fine, bad = made.record(SEED), made.record(SEED, "idv_01")
    assert fine.values.shape == (SAMPLES, 34)
    assert np.array_equal(fine.values[: bad.onset], bad.values[: bad.onset]), "the same seed is the same noise"
    assert not np.array_equal(fine.values[bad.onset + 1], bad.values[bad.onset + 1])
    assert len(made.sizes) == 20


def test_without_tep_studio_its_plant_says_so(monkeypatch):
    monkeypatch.setattr("gateway_arena.plants.tennessee.find_spec", lambda _: None)
    with pytest.raises(InputError, match="pip install tep-studio"):
        plant("tennessee")
