"""Tables of values are drives: a CSV, a column of which may say where something is wrong."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from gateway.cli import app
from gateway_fdi.errors import InputError
from gateway_fleet.study.drives.tables import Columns, columns_of, is_table, read
from gateway_fleet.study.drives.vehicles import vehicles

ROWS, WRONG = 1200, slice(800, 1100)


def table(path, seed, *, jump=12.0):
    """A pump at 1 Hz: pressure and flow swing, a temperature wanders; the flow is wrong for a while."""
    rng = np.random.default_rng(seed)
    pressure, flow = rng.normal(3.0, 0.2, ROWS), rng.normal(30.0, 1.0, ROWS)
    warm = 60.0 + np.cumsum(rng.normal(0, 0.1, ROWS))
    flow[WRONG] += jump
    wrong = np.zeros(ROWS)
    wrong[WRONG] = 1.0
    path.parent.mkdir(parents=True, exist_ok=True)
    start = np.datetime64("2020-03-09T10:14:33")
    lines = [
        f"{str(start + k).replace('T', ' ')};{pressure[k]:.5f};{flow[k]:.4f};{warm[k]:.3f};{wrong[k]};{k % 7}"
        for k in range(ROWS)
    ]
    path.write_text("\n".join(["datetime;Pressure;Flow RateRMS;Temp;anomaly;changepoint", *lines]) + "\n")


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    for seed in (1, 2):
        table(folder / "pump" / f"{seed}.csv", seed)
    arguments = ["evaluate", "drives", str(folder), "--workers", "0", "--json", "--column", "out=changepoint"]
    result = CliRunner().invoke(app, [*arguments, "--false-per-hour", "36", "--out", str(folder / "learned")])
    assert result.exit_code == 0, result.output
    return folder, json.loads(result.stdout.splitlines()[-1])


def test_rows_that_are_wrong_are_found_at_the_rate_that_was_asked_for(told):
    _, found = told
    assert [one["vehicle"] for one in found["vehicles"]] == ["pump/1", "pump/2"]
    points = found["points"]
    assert points["wrong"] == 2 * 300
    assert points["found"] > 0.9 * points["wrong"]
    assert points["healthy"] == 2 * (ROWS - 300 - 533)
    assert points["false"] < 0.1 * points["healthy"]
    assert not found["faults"], "its own truth is judged, no faults are put in"


def test_what_only_wanders_has_no_limit_that_accuses_it(told):
    folder, _ = told
    text = (folder / "learned" / "pump" / "1" / "car.toml").read_text()
    low, high = (float(part) for part in text.split('"Temp.Temp", plausible = [')[1].split("]")[0].split(","))
    assert (low < 0.0, high > 300.0) == (True, True)
    assert '"Flow_RateRMS.Flow_RateRMS"' in text


def test_a_table_is_told_from_frames_and_its_columns_are_named(tmp_path):
    table(tmp_path / "a.csv", 3)
    assert is_table(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text("Time Stamp,ID,Extended,Dir,Bus,LEN,D1\n1,2,false,Rx,0,1,00\n")
    assert not is_table(tmp_path / "b.csv")
    plain = read(tmp_path / "a.csv", columns_of(["out=changepoint"]))
    assert plain.names == ("Pressure", "Flow RateRMS", "Temp")
    assert plain.truth.sum() == 300
    assert np.diff(plain.t_ns).tolist() == [10**9] * (ROWS - 1)
    other = read(tmp_path / "a.csv", Columns(time="Temp", truth="Pressure", out=("datetime",)))
    assert other.names == ("Flow RateRMS", "anomaly", "changepoint")
    assert next(vehicle.columns for vehicle in vehicles(tmp_path)) == Columns()


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (["time=when"], "no such column"),
        (["when=time"], "time=NAME"),
        (["out=changepoint", "truth=datetime"], "no table of numbers"),
    ],
)
def test_columns_that_are_not_there_are_refused(tmp_path, columns, said):
    table(tmp_path / "a.csv", 4)
    with pytest.raises(InputError, match=said):
        read(tmp_path / "a.csv", columns_of(columns))
