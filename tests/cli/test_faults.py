"""``gateway faults``: what the commands print and write."""

import json

import pytest
from fault_examples import catalogue, event, nothing
from rig import Rig, write_config
from typer.testing import CliRunner

from gateway.bus.logs import LogReader
from gateway.cli import app, present
from gateway.faults.memory import FaultMemory
from gateway.faults.resilient_store import ResilientStore
from gateway_commands import faults
from gateway_fdi.errors import InputError

RECORDING = "[memory]\nrecording = { before_ms = 20.0, after_ms = 10.0 }\n"


@pytest.fixture
def run(tmp_path):
    rig = Rig(
        write_config(
            tmp_path,
            2,
            extra=RECORDING,
            faults={
                0: 'freeze_frame = ["M0.Value"]\n',
                1: "debounce = { failed_after = 10, passed_after = 1, jump_down = true }\n",
            },
        ),
        tmp_path / "f.sqlite",
    )
    rig.value(0, 2.5)
    rig.fail(0)
    for _ in range(3):
        rig.fail(1)
    rig.heal(1)
    rig.gateway.stop(rig.now)
    rig.close()

    def command(*arguments):
        made = CliRunner().invoke(app, ["faults", *map(str, arguments)])
        assert made.exit_code == 0, made.output
        return made.output

    return command


def test_show(run, tmp_path):
    text = run("show", "P1000-11", "--memory", tmp_path / "f.sqlite")
    assert "M0.Value" in text
    assert "2.5" in text
    assert "recordings  1" in text
    shown = json.loads(run("show", "P1000-11", "--memory", tmp_path / "f.sqlite", "--json"))
    assert (shown["recordings"], shown["permanent"], shown["peak_fdc"]) == (1, False, 127)


def test_near_misses(run, tmp_path):
    text = run("near-misses", "--memory", tmp_path / "f.sqlite")
    assert "b.M1.length" in text
    found = json.loads(run("near-misses", "--memory", tmp_path / "f.sqlite", "--json"))
    assert {entry["fault"]: entry["near_misses"] for entry in found} == {
        "b.M0.length": 0,
        "b.M1.length": 1,
    }


def test_recordings_are_logs_that_can_be_read(run, tmp_path):
    out = tmp_path / "logs"
    (entry,) = json.loads(run("recordings", "P1000-11", "--memory", tmp_path / "f.sqlite", "--out", out, "--json"))
    frames = [frame for batch in LogReader(out / "P1000-11-1.log") for frame in batch]
    assert len(frames) == entry["frames"] > 2
    assert "P1000-11-1.log" in run("recordings", "P1000-11", "--memory", tmp_path / "f.sqlite", "--out", out)


def test_export(run, tmp_path):
    run("export", tmp_path / "rig.toml", "--out", tmp_path / "catalogue.json")
    written = json.loads((tmp_path / "catalogue.json").read_text())
    assert written == json.loads(run("export", tmp_path / "rig.toml"))
    own = ["U3000-44", "U3000-42", "U3000-47", "U3000-53"]  # of the gateway itself
    assert [fault["dtc"] for fault in written["faults"]] == ["P1000-11", "C1001-11", *own]


def test_a_reader_without_the_configuration_learns_what_a_fault_is(run, tmp_path):
    """The memory itself has description, severity and what to do; also of an entry in a list."""
    memory = tmp_path / "f.sqlite"
    text = run("show", "P1000-11", "--memory", memory)
    assert "what        frame shorter than its message" in text
    assert "severity    none: no statement on when to have it checked" in text
    assert "what to do  check the sender's software against the database" in text
    told = {
        "description": "frame shorter than its message, or of another length than it may have",
        "severity": "none",
        "class": "unclassified",
        "remedy": "check the sender's software against the database",
    }
    shown = json.loads(run("show", "P1000-11", "--memory", memory, "--json"))
    assert told.items() <= shown.items()
    (listed,) = json.loads(run("list", "--memory", memory, "--json"))
    assert told.items() <= listed.items()


def test_what_the_configuration_says_of_a_fault(tmp_path):
    own = 'severity = "immediately"\ndtc_class = "a"\ndescription = "Brake ECU silent"\nremedy = "check fuse F7"\n'
    rig = Rig(write_config(tmp_path, 1, faults={0: own}), tmp_path / "f.sqlite")
    rig.fail(0)
    rig.close()
    made = CliRunner().invoke(app, ["faults", "show", "P1000-11", "--memory", str(tmp_path / "f.sqlite")])
    assert "what        Brake ECU silent" in made.output
    assert "severity    immediately: stop, and have it checked at once" in made.output
    assert "what to do  check fuse F7" in made.output


def test_tables_at_80_columns_cut_nothing(run, tmp_path, monkeypatch):
    monkeypatch.setattr(present, "WIDTH", 80)
    memory = tmp_path / "f.sqlite"
    for command in ("list", "near-misses"):
        text = run(command, "--memory", memory)
        assert max(map(len, text.splitlines())) <= 80
        assert "…" not in text
        assert "P1000-11" in text
        assert "b.M0.length" in text


def test_a_long_id_and_stamps_of_the_calendar_at_80_columns(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(present, "WIDTH", 80)
    entry = {
        "dtc": "U0401-83",
        "fault": "powertrain_of_the_second_axle.EngineTemperature1.counter",
        "status": 0x2F,
        "confirmed": True,
        "occurrence": 255,
        "first_ns": 1_763_806_108_123_456_789,
        "last_ns": 1_763_806_209_123_456_789,
        "freeze_frames": [1, 2],
        "description": "alive counter jumped (frames lost) or stands still (frame repeated)",
    }
    monkeypatch.setattr(faults.service, "list_entries", lambda _: [entry])
    monkeypatch.setattr(faults.service, "overflowed", lambda _: False)
    monkeypatch.setattr(faults.service, "restarts", lambda _: {"count": 0})
    faults.list_faults(None, memory=tmp_path, json=False)
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80
    for stamp in ("2025-11-22 10:08:28", "2025-11-22 10:10:09", "U0401-83", "0x2F"):
        assert stamp in text
    column = "".join(line[14:].split("  ")[0].strip() for line in text.splitlines()[2:])
    assert column == entry["fault"]
    monkeypatch.setattr(present, "WIDTH", 160)
    faults.list_faults(None, memory=tmp_path, json=False)
    assert "alive counter jumped (frames lost)" in capsys.readouterr().out


def test_a_damaged_file_is_one_clear_error_and_is_left_as_it_is(run, tmp_path):
    path = tmp_path / "f.sqlite"
    content = bytearray(path.read_bytes())
    at = content.index(b"b.M0.length")
    content[at : at + 4] = b"b.M7"
    path.write_bytes(content)
    for arguments in (("list",), ("show", "P1000-11"), ("clear",), ("near-misses",)):
        made = CliRunner().invoke(app, ["faults", *arguments, "--memory", str(path)])
        assert isinstance(made.exception, InputError), (arguments, made.output, made.exception)
        assert "f.sqlite: a damaged fault memory" in str(made.exception)
        assert "puts it aside" in str(made.exception)
    assert path.read_bytes() == content


def test_a_memory_whose_gateway_cannot_write_it_says_so(tmp_path):
    store = ResilientStore(tmp_path / "f.sqlite")
    memory = FaultMemory(catalogue((1,)), store)
    memory.start_cycle(0)
    memory.apply(event(0, True), nothing)
    memory.commit()
    listing = ["faults", "list", "--memory", str(tmp_path / "f.sqlite")]
    assert "stored: false" not in CliRunner().invoke(app, listing).output
    store.note_unsaved(True)
    assert "stored: false" in CliRunner().invoke(app, listing).output
    made = CliRunner().invoke(app, [*listing, "--json"])
    (entry,) = json.loads(made.stdout)
    assert entry["stored"] is False
    store.close()
