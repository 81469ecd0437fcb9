"""From one file to a DTC on the bus: a method of the arena as a monitor, fitted, checked, and stepped in Python."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import gateway_api as api
from gateway.cli import app
from gateway_arena.methods.machine_learning import Forest, Pca
from gateway_arena.monitor.fit import fitted
from gateway_arena.plants import plant
from gateway_arena.trial import records
from gateway_commands.new_monitor import new_monitor
from gateway_fdi.errors import GatewayError, InputError

SEED = 11
MINE = """
import numpy as np


class Mine:
    def fit(self, plant, healthy, faulty):
        values = np.concatenate([record.values for record in healthy])
        self.middle, self.half = values.mean(0), np.ptp(values, 0) / 2

    def step(self, sample):
        return float(np.max(np.abs(sample - self.middle) / self.half))


class Slips(Mine):
    def step(self, sample):
        if sample[0] < 11.0:
            raise RuntimeError("too low for me")
        return super().step(sample)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder that ``gateway new-monitor --from`` has written."""
    place = tmp_path_factory.mktemp("method")
    (place / "mine.py").write_text(MINE)
    assert new_monitor("mine_monitor", place / "new", f"{place / 'mine.py'}:Mine") == 0
    return place / "new"


def events(run):
    return [event for event in run.events if event["event"] == "dtc"]


@pytest.mark.long
def test_from_one_file_to_a_dtc_that_heals(folder):
    run = api.simulate(folder / "drained.toml", record=folder / "drained.log", series=True)
    assert run.expectations["met"].all(), list(run.expectations.records())
    score = run.series["mine_monitor.score"]
    judged = score.t_s[np.isfinite(score.value)]
    assert judged.min() == pytest.approx(24.1), "240 samples settle first"
    setup = api.open(folder / "gateway.toml")
    again = setup.replay(folder / "drained.log")
    assert [e["t_ns"] for e in events(again)] == [e["t_ns"] for e in events(run)], "live is as a replay is"


@pytest.mark.long
def test_a_gap_begins_again_and_is_counted(folder):
    log = folder / "gap.log"
    api.simulate(folder / "drained.toml", record=log)
    setup = api.open(folder / "gateway.toml")
    run = setup.replay(log, inject=["drop BATT @40..45"])
    readout = run.summary["monitors"]["mine_monitor"]
    assert readout["begun"] == 1
    assert not any(e["fault"] == "mine_monitor.abnormal" for e in events(run) if e["t_ns"] < 69e9), "it settles first"


def test_what_was_not_fitted_for_this_is_refused(folder, tmp_path):
    for file in filter(Path.is_file, folder.iterdir()):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    fit, config = tmp_path / "mine_monitor.fit", tmp_path / "gateway.toml"
    good, text = fit.read_bytes(), config.read_text()
    api.open(config)
    head, _, payload = good.partition(b"\n")
    old = json.loads(head)
    old["versions"]["python"] = "3.1"
    cases = [
        (good[:-1] + bytes([good[-1] ^ 1]), text, "damaged"),
        (b"no fit", text, "no file of gateway fit"),
        (json.dumps(old).encode() + b"\n" + payload, text, "python 3.1"),
        (good, text.replace("100.0", "200.0"), "period_ms = 100"),
        (good, text.replace("mine.py", "gone.py"), "method = 'gone.py:Mine'"),
    ]
    for kept, written, why in cases:
        fit.write_bytes(kept)
        config.write_text(written)
        with pytest.raises(GatewayError, match=why) as found:
            api.open(config)
        assert str(fit) in str(found.value) or "gone" in why
    config.write_text(text)
    (tmp_path / "mine.py").write_text(MINE + "\n")
    with pytest.raises(GatewayError, match="another text"):
        api.open(config)
    fit.unlink()
    with pytest.raises(GatewayError, match="gateway fit"):
        api.open(config)


@pytest.mark.long
def test_a_method_that_fails_is_switched_off_and_told(folder, tmp_path):
    for file in filter(Path.is_file, folder.iterdir()):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    config = tmp_path / "gateway.toml"
    config.write_text(config.read_text().replace(":Mine", ":Slips"))
    fitted(config, [tmp_path / "healthy.log"], monitor=None, faults=())
    run = api.simulate(tmp_path / "drained.toml")
    (off,) = [event for event in run.events if event["event"] == "monitor_off"]
    assert off["monitor"] == "mine_monitor"
    assert off["t_ns"] == pytest.approx(60e9, abs=0.2e9)


def test_what_cannot_be_fitted_is_refused(folder, tmp_path):
    config = folder / "gateway.toml"
    with pytest.raises(InputError, match="too few"):
        api.simulate(folder / "drained.toml", record=tmp_path / "short.log")
        fitted(config, [tmp_path / "short.log"], monitor=None, faults=())
    with pytest.raises(InputError, match="--monitor"):
        fitted(config, [folder / "healthy.log"], monitor="other", faults=())
    with pytest.raises(InputError, match=r'type = "structural"'):
        new_monitor("some_name", tmp_path / "x", "structural")
    with pytest.raises(InputError, match="needs step"):
        new_monitor("some_name", tmp_path / "x", "ekf")
    assert not (tmp_path / "x").exists()
    assert CliRunner().invoke(app, ["fit", str(config), str(tmp_path / "none.log")]).exit_code != 0


@pytest.mark.long
@pytest.mark.parametrize("kind", [Pca, Forest])
def test_samples_one_by_one_say_what_the_record_does(kind):
    made = plant("stiff_motor")
    given = records(made, SEED, runs=1, healthy=1, train=4, off=0.0)
    print("seed", SEED)
    learned = kind()
    learned.fit(made, given.learned, given.seen)
    record = given.faulty[2]
    whole = learned.run(record)
    again = pickle.loads(pickle.dumps(learned))
    again.reset()
    parts = [again.feed(part) for part in np.split(record.values, [1, 2, 30, 240, 241, 700])]
    assert np.allclose(np.concatenate([part.score for part in parts]), whole.score, rtol=1e-6)
    if kind is Forest:
        assert np.allclose(np.concatenate([part.weights for part in parts]), whole.weights)
    again.limit(1.0)
    again.reset()
    assert again.feed(record.values).score.max() <= 5.0
