"""``gateway doctor --bench``, by crank_healthy, and docs/performance.md: what is measured is told, and nothing else."""

import importlib.util
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gateway.cli import app
from gateway_bench.cli import measure

ROOT = Path(__file__).parents[2]


def test_all_four_are_measured(tmp_path, capsys):
    found = measure.measure(tmp_path, 0.02)
    assert found["replay"]["frames_per_s"] == pytest.approx(1e6 / found["replay"]["us_per_frame"])
    for name in ("one_frame", "wake", "write"):
        assert found[name]["count"] >= 1
        assert 0 < found[name]["p50_us"] <= found[name]["p99_us"]
    assert list(tmp_path.iterdir()) == [], "nothing is left of it"
    measure.print_measurements(found)
    told = capsys.readouterr().out
    assert "a DTC on the disk" in told
    assert max(map(len, told.splitlines())) <= 80


def test_a_folder_that_cannot_be_written_is_told(tmp_path, capsys):
    found = measure.measure(tmp_path / "gone", 0.01)
    assert found["write"] == {"folder": str(tmp_path / "gone"), "count": 0}
    measure.print_measurements(found)
    assert "DTCs would not be kept there" in capsys.readouterr().out


def test_a_write_is_really_one(tmp_path, monkeypatch):
    written = []
    save = measure.Store.save
    monkeypatch.setattr(measure.Store, "save", lambda self, changes: (written.append(changes), save(self, changes)))
    monkeypatch.setattr(measure, "_times", lambda work, seconds: [work(k) or 1.0 for k in range(2)])
    measure.write(tmp_path)
    first, second = (changes.records[0] for changes in written)
    assert first != second, "what does not change costs nothing"


def test_the_command_has_it_in_json(tmp_path, monkeypatch):
    monkeypatch.setattr(measure.Speed, "measure", staticmethod(lambda folder: measure.measure(folder, 0.01)))
    done = CliRunner().invoke(app, ["doctor", "--bench", "--json", "--memory", str(tmp_path / "f.sqlite")])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["bench"]["write"]["folder"] == str(tmp_path)


def tables():
    spec = importlib.util.spec_from_file_location("bench_main", ROOT / "bench" / "__main__.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_table_replaces_what_stood_between_the_marks_and_nothing_else():
    made = tables()
    text = f"before\n{made.BEGIN}\nold\n{made.END}\nafter\n"
    assert made.replaced(text, "new") == f"before\n{made.BEGIN}\nnew\n{made.END}\nafter\n"
    for wrong in ("no marks", f"{made.END}{made.BEGIN}", text + text):
        with pytest.raises(SystemExit, match="needs the lines"):
            made.replaced(wrong, "new")


def test_the_page_has_the_marks():
    made = tables()
    assert "x" in made.replaced(made.PAGE.read_text(), "x")
