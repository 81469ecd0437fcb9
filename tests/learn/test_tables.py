"""Tables of values are drives: a CSV, a column of which may say where something is wrong."""

import json
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

from gateway.cli import app
from gateway.config.load import load_config
from gateway_fdi.errors import InputError
from gateway_fleet.study.drives.judge import findings_of
from gateway_fleet.study.drives.tables import FIRST_ID, Columns, columns_of, is_table, read
from gateway_fleet.study.drives.vehicles import Learning, drive_of, vehicles

ROWS, WRONG = 1200, slice(800, 1100)


def table(path, seed, *, jump=12.0):
    """A pump at 1 Hz: pressure and flow swing, a temperature wanders; the flow is wrong for a while."""
    rng = np.random.default_rng(seed)
    pressure, flow = rng.normal(3.0, 0.2, ROWS), rng.normal(30.0, 1.0, ROWS)
    warm = 60.0 + np.cumsum(rng.normal(0, 0.1, ROWS))
    flow[WRONG] += jump
    write(path, {"Pressure": pressure, "Flow RateRMS": flow, "Temp": warm})


def write(path, columns):
    """Write a table whose rows are marked where they are wrong."""
    wrong = np.zeros(ROWS)
    wrong[WRONG] = 1.0
    path.parent.mkdir(parents=True, exist_ok=True)
    start = np.datetime64("2020-03-09T10:14:33")
    lines = [
        f"{str(start + k).replace('T', ' ')};{';'.join(f'{each[k]:.5f}' for each in columns.values())};{wrong[k]};{k}"
        for k in range(ROWS)
    ]
    path.write_text("\n".join([f"datetime;{';'.join(columns)};anomaly;changepoint", *lines]) + "\n")


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


def test_a_higher_rate_never_makes_a_limit_of_a_learned_file_wider(tmp_path):
    rng = np.random.default_rng(3)
    write(tmp_path / "pump" / "1.csv", {f"S{k}": rng.uniform(-1.0, 1.0, ROWS) for k in range(6)})
    (vehicle,) = vehicles(tmp_path, Columns(out=("changepoint",)))
    before: dict[str, tuple[float, float]] = {}
    for per_hour in (20.0, 60.0, 240.0):
        (learned,) = Learning(tmp_path / f"{per_hour:g}", 1, per_hour).do(vehicle)
        with learned.config.open("rb") as file:
            signals = [one for monitor in tomllib.load(file)["monitor"] for one in monitor.get("signal", ())]
        ends = {one["signal"]: one["plausible"] for one in signals if "plausible" in one}
        assert len(ends) == 6
        for name, (low, high) in before.items():
            assert low <= ends[name][0] < ends[name][1] <= high, f"{name} at {per_hour:g} per hour"
        before = ends


@pytest.mark.parametrize("rows", [1, 2])
def test_at_1_hz_one_odd_value_is_no_code_and_two_are(told, rows):
    folder, _ = told
    home = folder / "learned" / "pump" / "2"
    config = load_config(home / "car.toml")
    frames = drive_of(home / "first.log", config)
    flow = np.flatnonzero(frames["can_id"] == FIRST_ID + 1)[250 : 250 + rows]
    before = findings_of(config, frames).codes
    frames["data"][flow, :8] = np.array([90.0]).view(np.uint8)
    new = findings_of(config, frames).codes.keys() - before.keys()
    assert new == ({"signals.Flow_RateRMS.high"} if rows == 2 else set())


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
