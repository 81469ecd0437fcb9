"""gateway import: a file of layouts becomes a configuration that loads."""

import json

import pytest
from answer_files import odx, signal_set

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_ask.answer_buses import address_of
from gateway_ask.answers.layout import Address, layouts_for, read_layouts
from gateway_ask.cli.import_layouts import import_layouts
from gateway_fdi.errors import InputError


def imported(source, out, **options):
    """Run the command's work."""
    usual = {"bus": "obd=virtual:obd", "request": None, "response": None, "year": None, "force": False, "json": True}
    return import_layouts(source, out=out, **usual | options)


def test_a_signal_set_becomes_ecus_that_are_asked(tmp_path, capsys):
    source, out = tmp_path / "car.json", tmp_path / "sub" / "ecu.toml"
    out.parent.mkdir()
    source.write_text(signal_set())
    assert imported(source, out) == 0
    told = json.loads(capsys.readouterr().out)
    config = load_config(out)
    ecus = {ecu.name: ecu for ecu in config.ecu}
    assert set(ecus) == {"ecu_7E4", "ecu_18DA10F1", "ecu_750_2A"}
    assert [read.key for read in ecus["ecu_7E4"].read] == [(0x22, 0x0101), (0x21, 0x05)]
    assert [read.every_ms for read in ecus["ecu_7E4"].read] == [1000, 5000]
    assert (ecus["ecu_18DA10F1"].address, ecus["ecu_750_2A"].target) == (0x10, 0x2A)
    for ecu in config.ecu:  # each read has its layout in the files that the table names
        own = layouts_for([each for file in ecu.signals for each in read_layouts(out.parent / file)], address_of(ecu))
        assert {read.key for read in ecu.read} <= set(own)
    assert told["requests_per_s"] == pytest.approx(1 + 1 / 5 + 1 / 60 + 1 / 5, abs=1e-3)
    assert any("VIN" in part["where"] for part in told["left_out"])


def test_limits_of_the_file_become_a_monitor_where_it_is_wanted(tmp_path, capsys):
    source, out = tmp_path / "car.json", tmp_path / "ecu.toml"
    source.write_text(signal_set())
    imported(source, out)
    head, _, monitor = out.read_text().partition("take the # away:\n")
    out.write_text(head + "\n" + monitor.replace("# ", ""))
    gateway = Gateway(load_config(out))
    names = {definition.id for definition in gateway.catalogue}
    gateway.close()
    assert {"limits.T.low", "limits.T.high"} <= names


def test_identifiers_of_answers_that_a_file_leaves_out_are_assumed_and_told(tmp_path, capsys):
    source, out = tmp_path / "car.json", tmp_path / "ecu.toml"
    signal = {"id": "A", "name": "A", "fmt": {"len": 8, "max": 255, "unit": "scalar"}}
    headers = {"7B0": 0x7B8, "7DF": 0x7E8, "DA40": 0x18DAF140}  # 7DF: to all, so to the engine
    commands = [{"hdr": header, "cmd": {"22": "0101"}, "freq": 1, "signals": [signal]} for header in headers]
    source.write_text(json.dumps({"commands": commands}))
    imported(source, out)
    assert [ecu.place.response & 0x1FFFFFFF for ecu in load_config(out).ecu] == list(headers.values())
    assert len(json.loads(capsys.readouterr().out)["assumed"]) == 3
    (to_all,) = [one for one in read_layouts(source) if one.address is None]
    assert layouts_for([to_all], Address(0x7E0, 0x7E8))


def test_a_model_year_has_a_signal_set_of_its_own(tmp_path, capsys):
    source, out = tmp_path / "car.json", tmp_path / "ecu.toml"
    source.write_text(signal_set())
    assert imported(source, out, year=2012) == 0
    found = read_layouts(tmp_path / "ecu-2012.json")
    assert [s.name for one in found if one.name == "2105" for s in one.message.signals] == ["S"]
    assert load_config(out).ecu[0].signals[0].name == "ecu-2012.json"
    assert capsys.readouterr().out


def test_files_are_not_overwritten_unasked(tmp_path, capsys):
    source, out = tmp_path / "car.json", tmp_path / "ecu.toml"
    source.write_text(signal_set())
    out.write_text("mine")
    with pytest.raises(InputError, match="--force"):
        imported(source, out)
    assert out.read_text() == "mine"
    imported(source, out, force=True)
    assert "[[ecu]]" in out.read_text()
    (tmp_path / "new-2012.json").write_text("mine")
    with pytest.raises(InputError, match=r"new-2012\.json"):
        imported(source, tmp_path / "new.toml", year=2012)
    assert not (tmp_path / "new.toml").exists()


def test_a_file_without_addresses_needs_them(tmp_path, capsys):
    source, out = tmp_path / "battery.odx-d", tmp_path / "ecu.toml"
    source.write_text(odx())
    with pytest.raises(InputError, match="--request"):
        imported(source, out)
    with pytest.raises(InputError, match="an identifier"):
        imported(source, out, request="x7E4", response="0x7EC")
    with pytest.raises(InputError, match="go together"):
        imported(source, out, request="0x7E4")
    imported(source, out, request="0x7E4", response="0x7EC", json=False)
    assert [ecu.request for ecu in load_config(out).ecu] == [0x7E4]
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80 + len(str(out))
