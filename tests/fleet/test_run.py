"""``gateway fleet run`` in one process: what is new, what is wrong with logs, memories carried, two runs compared."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from duck import ask
from fleet_logs import tables_hash, write_config, write_fleet, write_log
from typer.testing import CliRunner

from gateway.cli import app
from gateway.faults.store import Store
from gateway_fdi.errors import InputError
from gateway_fleet.fleet import verdicts as verdicts_module
from gateway_fleet.fleet.diff import diff
from gateway_fleet.fleet.run import Order, run
from gateway_fleet.fleet.task import MOST_EVENTS, _Watch
from gateway_fleet.fleet.verdicts import TABLES, Verdicts
from gateway_logs.corpus import find


@pytest.fixture
def fleet(tmp_path):
    """Twenty logs of five cars, and a configuration."""
    write_config(tmp_path)
    write_fleet(tmp_path / "logs", 20, frames=300)
    return tmp_path


def order(folder, out="out", *, config="car.toml", logs="logs/**", **more):
    return Order(find([folder / logs]), folder / config, folder / out, workers=0, **more)


def judged(result):
    return sorted(outcome.recording.path.name for outcome in result.outcomes)


def test_verdicts_of_a_fleet(fleet):
    result = run(order(fleet))
    assert len(result.outcomes) == 20
    verdicts = Verdicts(fleet / "out")
    logs = {Path(row["path"]).name: row for row in verdicts.rows("logs")}
    assert {row["device"] for row in logs.values()} == {f"car{k}" for k in range(5)}
    one = logs["00003.log"]
    assert (one["state"], one["frames"], one["decoded"], one["dtcs"], one["left_out"]) == ("whole", 300, 300, 1, 0)
    assert one["begin"] == (1_700_000_000 + 3 * 3600) * 10**9
    assert one["seconds"] == pytest.approx(2.99)
    assert one["km"] == pytest.approx(36 / 3600 * 2.99, rel=0.1)
    dtcs = verdicts.rows("dtcs")
    assert sorted(row["dtc"] for row in dtcs) == ["C0070-85", "C0070-85", "U0100-87", "U0100-87"]
    (high,) = (row for row in dtcs if row["log"] == one["log"])
    evidence = json.loads(high["evidence"])
    assert evidence["value"] > evidence["threshold"] == 1000.0
    tests = {row["fault"]: row for row in verdicts.rows("tests", one["log"])}
    assert tests["voltage.Value.high"]["ratio"] == pytest.approx(1.2)
    assert tests["voltage.Value.high"]["high"] == 1200.0
    assert tests["voltage.Value.high"]["results"] == 300
    events = verdicts.rows("events", one["log"])
    assert [row["n"] for row in events] == list(range(len(events)))
    assert events[0]["t"] == high["first"]
    assert not verdicts.rows("errors")
    assert not list((fleet / "out").rglob(".*")), "nothing half written stays"


def test_a_second_run_does_what_is_new(fleet):
    run(order(fleet))
    before = tables_hash(fleet / "out")
    again = run(order(fleet))
    assert (again.known, again.outcomes) == (20, [])
    assert tables_hash(fleet / "out") == before
    write_log(fleet / "logs" / "car1" / "new.log", seed=99, frames=300)
    assert judged(run(order(fleet))) == ["new.log"]
    write_log(fleet / "logs" / "car1" / "new.log", seed=100, frames=300)  # another one under the same name
    assert judged(run(order(fleet))) == ["new.log"]
    os.utime(fleet / "logs" / "car1" / "new.log", ns=(1, 1))
    (same,) = run(order(fleet)).outcomes
    assert not same.fresh, "its contents are known"


def test_a_run_that_was_killed_goes_on(fleet):
    run(order(fleet))
    manifest = fleet / "out" / "manifest.jsonl"
    lines = manifest.read_text().splitlines(keepends=True)
    manifest.write_text("".join(lines[:7]) + lines[7][:20])
    before = tables_hash(fleet / "out")
    result = run(order(fleet))
    assert result.known == 7
    assert len(result.outcomes) == 13
    assert not any(outcome.fresh for outcome in result.outcomes)
    assert tables_hash(fleet / "out") == before
    assert run(order(fleet)).known == 20


def test_the_tables_of_a_run_are_one_file_each(fleet, monkeypatch):
    """Files of single logs that a kill has left count once, in any state of putting them together."""
    monkeypatch.setattr(Verdicts, "put_together", lambda self: None)
    run(order(fleet))
    single = {table: Verdicts(fleet / "out").rows(table) for table in TABLES}
    kept = {path: path.read_bytes() for path in (fleet / "out").glob("*/*.parquet")}
    monkeypatch.undo()
    read = verdicts_module._batches

    def meanwhile(paths):
        """Has a run end while a reader has listed the files and reads none yet."""
        monkeypatch.undo()
        Verdicts(fleet / "out").put_together()
        return read(paths)

    monkeypatch.setattr(verdicts_module, "_batches", meanwhile)
    assert sorted(map(str, Verdicts(fleet / "out").rows("logs"))) == sorted(map(str, single["logs"]))
    assert {path.name for path in (fleet / "out").glob("*/*.parquet")} == {"all.parquet", "none.parquet"}
    together = tables_hash(fleet / "out")
    left = [path for table in TABLES for path in sorted(kept) if path.parent.name == table and not path.exists()]
    for done in (0, 1, 20, 21, len(left) - 1):  # how many were taken away before the kill
        for path in left[done:]:
            path.write_bytes(kept[path])
        verdicts = Verdicts(fleet / "out")
        for table, rows in single.items():
            assert sorted(map(str, verdicts.rows(table))) == sorted(map(str, rows)), table
        assert verdicts.rows("dtcs", single["dtcs"][0]["log"]) == single["dtcs"][:1]
        assert all(verdicts.has(row["log"]) for row in single["logs"])
        verdicts.put_together()
        assert tables_hash(fleet / "out") == together
        assert {path.name for path in (fleet / "out").glob("*/*.parquet")} == {"all.parquet", "none.parquet"}
    gone = single["dtcs"][0]["log"]
    Verdicts(fleet / "out").forget([gone])
    assert not Verdicts(fleet / "out").has(gone)
    assert not [row for table in TABLES for row in Verdicts(fleet / "out").rows(table) if row["log"] == gone]
    assert run(order(fleet)).known == 19
    assert tables_hash(fleet / "out") == together


def test_logs_with_something_wrong_are_rows_of_errors(fleet):
    logs = fleet / "logs" / "car0"
    whole = (logs / "00000.log").read_bytes()
    (logs / "corrupt.log").write_bytes(whole[:5000] + b"nonsense\n" + whole[5000:])
    (logs / "cut.log").write_bytes(whole[:5010])
    (logs / "empty.log").write_bytes(b"")
    (logs / "no.blf").write_bytes(b"LOG")
    (logs / "gone.log").symlink_to(logs / "nowhere.log")
    expected = {"corrupt.log": "damaged", "cut.log": "cut off", "empty.log": "empty", "no.blf": "cut off",
                "gone.log": "unreadable"}  # fmt: skip
    result = run(order(fleet))
    states = {outcome.recording.path.name: outcome.state for outcome in result.outcomes}
    assert {name: state for name, state in states.items() if state != "whole"} == expected
    errors = {Path(row["path"]).name: row for row in Verdicts(fleet / "out").rows("errors")}
    assert {name: row["kind"] for name, row in errors.items()} == expected
    assert "corrupt.log:102" in errors["corrupt.log"]["text"] or "corrupt.log:103" in errors["corrupt.log"]["text"]
    rows = {Path(row["path"]).name: row for row in Verdicts(fleet / "out").rows("logs")}
    assert rows["corrupt.log"]["frames"] > 50, "what came before is judged"
    assert run(order(fleet)).outcomes == [], "not tried again"
    assert judged(run(order(fleet, retry=True))) == ["gone.log"]


def test_a_log_of_another_bus_is_told(fleet):
    text = (fleet / "car.toml").read_text()
    (fleet / "two.toml").write_text(text + '[[bus]]\nname = "body"\nuri = "virtual:body"\ndatabase = ["car.dbc"]\n')
    (fleet / "logs" / "car0" / "00000.log").write_text("(1.0) vcan7 100#00\n")
    result = run(order(fleet, config="two.toml", logs="logs/car0/00000.log"))
    assert [outcome.state for outcome in result.outcomes] == ["foreign"]
    (row,) = Verdicts(fleet / "out").rows("errors")
    assert "vcan7" in row["text"]


def test_a_log_of_another_vehicle_is_told_and_not_judged(fleet):
    log = fleet / "logs" / "car0" / "00000.log"
    log.write_text("".join(f"({k / 10}) can0 7AA#00\n" for k in range(300)))
    result = run(order(fleet, logs="logs/car0/00000.log"))
    assert [outcome.state for outcome in result.outcomes] == ["foreign"]
    (row,) = Verdicts(fleet / "out").rows("errors")
    assert "of another vehicle" in row["text"]
    assert list(Verdicts(fleet / "out").rows("dtcs")) == []


def test_verdicts_of_another_configuration_are_not_mixed(fleet):
    run(order(fleet, logs="logs/car0"))
    write_config(fleet, high=700.0)
    with pytest.raises(InputError, match=r"another run \(configuration .*take another --out"):
        run(order(fleet))
    write_config(fleet)
    with pytest.raises(InputError, match="memory fresh, now carried"):
        run(order(fleet, carried=True))


def test_a_memory_that_is_carried_ages_over_a_cars_logs(fleet):
    """A DTC of the first log is there in the next ones without failing; batches of logs make no difference."""
    logs = fleet / "logs"
    for path in logs.rglob("*.log"):
        path.unlink()
    for k in range(6):
        write_log(logs / "A" / f"{k}.log", seed=k, frames=300, peak=1200.0 if k in (1, 4) else 600.0,
                  begin_s=1_700_000_000 + 3600 * k)  # fmt: skip
    write_log(logs / "B" / "0.log", seed=50, frames=300)
    run(order(fleet, "whole", carried=True))
    dtcs = {Path(row["path"]).name: row for row in Verdicts(fleet / "whole").rows("logs") if row["device"] == "A"}
    failing = {name for name, row in dtcs.items() if row["dtcs"]}
    assert failing == {"1.log", "4.log"}
    rows = sorted(Verdicts(fleet / "whole").rows("dtcs"), key=lambda row: row["first"])
    assert [row["occurrence"] for row in rows] == [1, 2]
    for count in (2, 4, 6):
        for k in range(6):
            hidden, path = logs / "A" / f".{k}", logs / "A" / f"{k}.log"
            if k >= count and path.exists():
                path.rename(hidden)
            if k < count and hidden.exists():
                hidden.rename(path)
        run(order(fleet, "parts", carried=True))
    assert tables_hash(fleet / "parts") == tables_hash(fleet / "whole")
    fresh = run(order(fleet, "fresh"))
    assert len(fresh.outcomes) == 7
    assert [row["occurrence"] for row in Verdicts(fleet / "fresh").rows("dtcs")] == [1, 1]
    write_log(logs / "A" / "05.log", seed=77, frames=300)
    with pytest.raises(InputError, match=r"05\.log: comes before 1\.log"):
        run(order(fleet, "whole", carried=True))


def test_the_same_contents_count_once_and_are_told(fleet):
    """Whoever is judged first: the verdict names the first path, each other one is a row of errors."""
    first = fleet / "logs" / "car0" / "00000.log"
    copy = fleet / "logs" / "car3" / "copy.log"
    copy.write_bytes(first.read_bytes())
    for device in ("car1", "car2"):
        (fleet / "logs" / device / "empty.log").write_bytes(b"")
    result = run(order(fleet))
    assert sorted(path.name for path in result.copies) == ["copy.log", "empty.log"]
    verdicts = Verdicts(fleet / "out")
    errors = {(row["kind"], Path(row["path"]).parent.name): row["text"] for row in verdicts.rows("errors")}
    assert set(errors) == {("copy", "car3"), ("copy", "car2"), ("empty", "car1")}
    assert str(first) in errors["copy", "car3"]
    backwards = order(fleet, "back")
    run(replace(backwards, recordings=list(reversed(backwards.recordings))))
    assert tables_hash(fleet / "back") == tables_hash(fleet / "out")
    # The first one goes: the copy is the log now.
    first.unlink()
    copy.rename(copy.with_name("moved.log"))
    run(order(fleet))
    (row,) = (row for row in verdicts.rows("logs") if Path(row["path"]).name in ("moved.log", "copy.log", "00000.log")
              and row["begin"] == 1_700_000_000 * 10**9)  # fmt: skip
    assert (Path(row["path"]).name, row["device"]) == ("moved.log", "car3")


def test_a_log_that_goes_on_counts_once(fleet):
    """A log was judged while it was still being written: its verdict gives way to that of the whole."""
    path = fleet / "logs" / "car1" / "growing.log"
    whole = write_log(path, seed=5, frames=300).read_bytes()
    path.write_bytes(whole[: len(whole) // 2 + 7])
    run(order(fleet))
    verdicts = Verdicts(fleet / "out")
    (half,) = (row for row in verdicts.rows("logs") if row["path"].endswith("growing.log"))
    path.write_bytes(whole)
    assert judged(run(order(fleet))) == ["growing.log"]
    (row,) = (row for row in verdicts.rows("logs") if row["path"].endswith("growing.log"))
    assert (half["frames"], row["frames"]) == (150, 300)
    assert not [row for row in verdicts.rows("errors") if row["path"].endswith("growing.log")], "cut off no more"
    run(order(fleet, "fresh"))
    assert tables_hash(fleet / "fresh") == tables_hash(fleet / "out")


def test_a_log_that_grows_while_it_is_judged_is_new_to_the_next_run(fleet):
    path = fleet / "logs" / "car1" / "growing.log"
    text = write_log(path, seed=5, frames=300).read_text()

    def progress(outcome, left):
        if outcome.recording.path.name == "growing.log":
            path.write_text(text + text.splitlines()[-1].replace("(17", "(18") + "\n")

    run(order(fleet), progress)
    assert judged(run(order(fleet))) == ["growing.log"]
    assert run(order(fleet)).outcomes == []


def test_a_copy_does_not_take_a_carried_memory_back(fleet):
    """Logs 0 to 3 of a car, and behind 2 a copy of 0: what 3 finds is the memory after 2."""
    logs = fleet / "logs"
    for path in logs.rglob("*.log"):
        path.unlink()
    for k in range(4):
        write_log(logs / "A" / f"{k}.log", seed=k, frames=300, peak=1200.0 if k in (1, 3) else 600.0,
                  begin_s=1_700_000_000 + 3600 * k)  # fmt: skip
    run(order(fleet, "without", carried=True))
    (logs / "A" / "2z.log").write_bytes((logs / "A" / "0.log").read_bytes())
    run(order(fleet, "with", carried=True))
    assert tables_hash(fleet / "with", but=("errors",)) == tables_hash(fleet / "without", but=("errors",))
    assert [row["kind"] for row in Verdicts(fleet / "with").rows("errors")] == ["copy"]
    hidden = logs / "A" / "3.log"
    hidden.rename(logs / "A" / ".3")
    run(order(fleet, "steps", carried=True))
    (logs / "A" / ".3").rename(hidden)
    run(order(fleet, "steps", carried=True))
    assert tables_hash(fleet / "steps") == tables_hash(fleet / "with")


def test_a_log_that_is_cut_off_completes_no_operation_cycle_of_a_carried_memory(fleet):
    logs = fleet / "logs"
    for path in logs.rglob("*.log"):
        path.unlink()
    for k in range(3):
        write_log(logs / "A" / f"{k}.log", seed=k, frames=300, peak=600.0, begin_s=1_700_000_000 + 3600 * k)
    text = (logs / "A" / "1.log").read_text()
    (logs / "A" / "1.log").write_text(text[:-5])
    found = []

    def progress(outcome, left):
        store = Store(fleet / "out" / "memory" / f"{outcome.log}.sqlite", write=False)
        power = store.cycles()["power"]
        found.append((outcome.state, power.number, power.open))
        store.close()

    run(order(fleet, carried=True), progress)
    assert found == [("whole", 1, False), ("cut off", 2, True), ("whole", 2, False)]


def test_a_changed_threshold_turns_one_verdict(fleet):
    run(order(fleet, "a"))
    write_log(fleet / "logs" / "car9" / "near.log", seed=7, peak=980.0)
    run(order(fleet, "a"))
    write_config(fleet, high=950.0, name="strict.toml")
    run(order(fleet, "b", config="strict.toml"))
    found = diff(fleet / "a", fleet / "b")
    (near,) = (one for one in found.changed if one.new)
    assert Path(near.path).name == "near.log"
    assert near.new == ("C0070-85 voltage.Value.high",)
    assert near.before is None
    assert near.after["status"] & 1
    assert 4.0 < near.at_s < 6.0
    others = [one for one in found.changed if not one.new]
    assert {Path(one.path).name for one in others} == {"00003.log", "00013.log"}, "the same DTC, earlier"
    assert found.same == 18
    ended = CliRunner().invoke(app, ["fleet", "diff", str(fleet / "a"), str(fleet / "b")])
    assert ended.exit_code == 1
    assert "3 logs changed their verdict, 18 did not" in ended.output
    same = CliRunner().invoke(app, ["fleet", "diff", str(fleet / "a"), str(fleet / "a"), "--json"])
    assert same.exit_code == 0
    assert json.loads(same.output)["same"] == 21
    assert diff(fleet / "a", fleet / "b").only_first == []
    with pytest.raises(InputError, match="no verdicts here"):
        diff(fleet / "a", fleet / "logs")


def test_the_command(fleet, monkeypatch):
    monkeypatch.chdir(fleet)
    ended = CliRunner().invoke(
        app, ["fleet", "run", "logs/**", "-c", "car.toml", "-o", "out", "--workers", "0", "--json"]
    )
    assert ended.exit_code == 0, ended.exception
    events = [json.loads(line) for line in ended.stdout.splitlines()]
    assert [event["event"] for event in events] == ["judged"] * 20 + ["fleet"]
    assert events[-1]["states"] == {"whole": 20}
    rows = ask("select device, count(*), sum(dtcs) from 'out/logs/*.parquet' group by device order by device")
    assert rows == [("car0", 4, 0), ("car1", 4, 0), ("car2", 4, 2), ("car3", 4, 2), ("car4", 4, 0)]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--memory", "old"], "the memories are fresh and carried"),
        (["--scheduler", "tcp://127.0.0.1:1", "--workers", "2"], "a scheduler has workers of its own"),
        (["--config", "none.toml"], "none.toml"),
    ],
)
def test_mistakes(words, text, fleet, monkeypatch):
    monkeypatch.chdir(fleet)
    ended = CliRunner().invoke(app, ["fleet", "run", "logs", "-o", "out", "--workers", "0", *words])
    if "--scheduler" in words:
        ended = CliRunner().invoke(app, ["fleet", "run", "logs", "-c", "car.toml", "-o", "out", *words])
    assert isinstance(ended.exception, InputError), ended.output
    assert text in str(ended.exception)


def test_without_the_extra_it_is_named(fleet, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "distributed", None)
    ended = CliRunner().invoke(app, ["fleet", "run", "logs", "-o", "out"])
    assert "pip install '.[fleet]'" in str(ended.exception)


def test_a_storm_of_events_is_bounded():
    watch = _Watch()
    for k in range(MOST_EVENTS + 5):
        watch({"event": "dtc", "t_ns": k, "dtc": "U0100-87", "fault": "f", "status": k % 2, "occurrence": k})
    assert len(watch.events) == MOST_EVENTS
    assert watch.lost == 5
    assert watch.first == {"f": 1}
