"""Layouts from the files that people have."""

import importlib.util
import json
import os
import random
import sys
from collections import defaultdict
from importlib.machinery import SourceFileLoader
from pathlib import Path

import cantools
import numpy as np
import odxtools
import pytest
from answer_files import CDD, NUMBERS, odx, signal_set

from gateway.bus.frames import EXTENDED
from gateway_ask.answers.decode import AnswerDecoder
from gateway_ask.answers.layout import Address, j1979, layouts_for, read_file
from gateway_ask.answers.model import AnswerLayout, message_of, signal_of
from gateway_fdi.errors import InputError

ROOT = Path(__file__).parents[2]
OBDB = Path(os.environ.get("GATEWAY_OBDB", ROOT.parent / "shared/data/obdb"))


def judge(name="judge-obdb"):
    """Return a script as a module."""
    spec = importlib.util.spec_from_loader(name, SourceFileLoader(name, str(ROOT / "scripts" / name)))
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def cars(tmp_path):
    file = tmp_path / "car.json"
    file.write_text(signal_set())
    return file


def one(layouts, name):
    (found,) = [layout for layout in layouts if layout.name == name]
    return found


def decoded(layout, data, **options):
    """Return the values of one answer that are there, by name."""
    found = AnswerDecoder(layout).decode([data], **options)
    return {name: float(found.values[k, 0]) for k, name in enumerate(found.names) if found.there[k, 0]}


@pytest.mark.parametrize(
    ("said", "asked", "answers"),
    [
        ({"hdr": "FC00", "rax": "FE0076", "pri": "17", "tst": "76"}, 0x17FC0076, 0x17FE0076),  # platform MEB of VW
        ({"hdr": "17FC0076", "rax": "FE0076"}, 0x17FC0076, 0x17FE0076),
        ({"hdr": "DA10", "rax": "10"}, 0x18DA10F1, 0x18DAF110),
        ({"hdr": "DA10", "rax": "18DAF110"}, 0x18DA10F1, 0x18DAF110),
    ],
)
def test_an_answer_has_the_identifier_whose_end_a_signal_set_gives(said, asked, answers, tmp_path):
    volts = {"id": "U", "name": "Volts", "fmt": {"len": 16, "max": 9, "unit": "volts"}}
    file = tmp_path / "car.json"
    file.write_text(json.dumps({"commands": [said | {"cmd": {"22": "0335"}, "freq": 1, "signals": [volts]}]}))
    assert read_file(file).layouts[0].address == Address(asked | EXTENDED, answers | EXTENDED)


def test_a_signal_set_gives_addresses_values_texts_and_limits(cars):
    found = read_file(cars)
    state = one(found.layouts, "220101")
    assert (state.address, state.every_s, state.message.length) == (Address(0x7E4, 0x7EC), 1, 5)
    # 12 bits with their bytes turned round: 0x?ABC is BC, ?A; the file's own tools take the first 12 bits of ?ABC.
    values = decoded(state, bytes.fromhex("2ee0c0 e0ff"))
    assert values == {"U": 12, "S": 1, "MODE": 2, "T": -0.5 * 2 + 1}
    assert decoded(state, bytes.fromhex("2ee0c0 10 00"))["T"] == 0.5 * 1 + 1
    signals = {signal.name: signal for signal in state.message.signals}
    assert str(signals["MODE"].choices[2]) == "run"
    assert str(signals["S"].choices[1]) == "on"
    assert (signals["U"].unit, signals["T"].unit) == ("V", "degC")
    assert (state.limits["T"].low, state.limits["T"].high) == (0, 40)
    # A value that the file calls none is none, unless it is asked for.
    assert "U" not in decoded(state, bytes.fromhex("ffffc0"))
    assert decoded(state, bytes.fromhex("ffffc0"), void=True)["U"] == 65.535
    assert one(found.layouts, "2130").address == Address(0x750, 0x758, 0x2A, 0x2A)
    assert one(found.layouts, "22F190").address == Address(0x18DA10F1 | EXTENDED, 0x18DAF110 | EXTENDED)
    assert any("VIN" in where for where, _ in found.left_out)


def test_a_command_without_response_is_of_the_ecu_that_has_one_and_of_its_years(cars):
    assert [signal.name for signal in one(read_file(cars).layouts, "2105").message.signals] == ["U"]
    old = one(read_file(cars, 2012).layouts, "2105")
    assert [signal.name for signal in old.message.signals] == ["S"]
    assert old.address == Address(0x7E4, 0x7EC)
    assert any("model year" in why for _, why in read_file(cars).left_out)
    own = layouts_for(read_file(cars).layouts, Address(0x7E4, 0x7EC))
    assert set(own) == {(0x22, 0x0101), (0x21, 0x05)}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d["commands"][0].update(hdr="7XY"), "commands[0].hdr = '7XY'"),
        (lambda d: d["commands"][0].update(cmd={"22": "1", "21": "2"}), "commands[0].cmd"),
        (lambda d: d["commands"][0]["signals"][0]["fmt"].update(len=-3), "commands[0].signals[0].fmt.len = -3"),
        (lambda d: d["commands"][0]["signals"][0]["fmt"].update(div=0), "commands[0].signals[0].fmt"),
        (lambda d: d["commands"][0]["signals"][0]["fmt"].update(bix=1 << 40), "commands[0].signals[0].fmt.bix"),
        (lambda d: d["commands"][0]["signals"][0].pop("id"), "commands[0].signals[0].id"),
        (
            lambda d: d["commands"][0]["signals"][1]["fmt"].update(map={"x": "y"}),
            "commands[0].signals[1].fmt.map = 'x'",
        ),
        (lambda d: d["commands"][0].update(filter={"from": "new"}), "commands[0].filter.from = 'new'"),
        (lambda d: d["commands"][1].update(filter={"years": ["old"]}), "commands[1].filter.years"),
        (lambda d: d.update(commands={}), "commands"),
    ],
)
def test_a_wrong_signal_set_is_refused_with_its_place(cars, change, said):
    document = json.loads(signal_set())
    change(document)
    cars.write_text(json.dumps(document))
    with pytest.raises(InputError) as caught:
        read_file(cars)
    assert said in str(caught.value)
    assert str(cars) in str(caught.value)


def test_files_that_are_none_are_refused(tmp_path):
    for name, text in (
        ("a.json", "{"),
        ("b.json", "[]"),
        ("c.cdd", "<x/>"),
        ("d.odx", "<x/>"),
        ("e.pdx", "no zip"),
        ("f.dbc", ""),
    ):
        file = tmp_path / name
        file.write_text(text)
        with pytest.raises(InputError, match=name):
            read_file(file)
    with pytest.raises(InputError, match="layouts of answers are in files"):
        read_file(tmp_path / "g.xls")


def test_a_database_has_a_message_a_request(tmp_path):
    file = tmp_path / "ecu.dbc"
    head = 'VERSION ""\nBS_:\nBU_: GW\n'
    did, other = (0x22F190 | 1 << 31), 0x123
    file.write_text(
        f'{head}BO_ {did} Cells: 70 GW\n SG_ Last : 535|16@0+ (0.001,0) [0|5] "V" GW\n'
        f'BO_ {other} Plain: 8 GW\n SG_ X : 0|8@1+ (1,0) [0|0] "" GW\n'
    )
    found = read_file(file)
    (cells,) = found.layouts
    assert (cells.service, cells.identifier, cells.message.length) == (0x22, 0xF190, 70)
    assert [where for where, _ in found.left_out] == ["Plain"]
    assert decoded(cells, bytes(66) + b"\x0e\x10") == {"Last": 3.6}
    assert decoded(cells, bytes(67)) == {}


def test_odx_is_decoded_as_odxtools_does(tmp_path):
    file = tmp_path / "battery.odx-d"
    file.write_text(odx())
    (layout,) = read_file(file).layouts
    assert (layout.service, layout.identifier) == (0x22, 0x1234)
    signals = {signal.name: signal for signal in layout.message.signals}
    assert signals["voltage"].unit == "V"
    (ecu,) = odxtools.load_file(file).base_variants
    rng = random.Random(7)
    for _ in range(200):
        data = rng.randbytes(13)
        (message,) = ecu.decode_response(b"\x62\x12\x34" + data, b"\x22\x12\x34")
        ours = decoded(layout, data)
        for name, *_ in NUMBERS:
            theirs = message.param_dict[name]
            if name == "door":
                assert str(signals[name].choices.get(int(ours[name]), "")) == theirs
            elif np.isfinite(theirs):
                assert ours[name] == pytest.approx(theirs, rel=1e-12)
            else:
                assert name not in ours


def test_short_and_long_answers_are_decoded_as_cantools_does():
    """Signals at random places of layouts up to 200 bytes, against cantools' own decoder."""
    seed = 11
    print("seed", seed)
    rng = random.Random(seed)
    for round_ in range(30):
        size = rng.choice((8, 64, 65, 130, 200))
        signals, taken = [], set()  # cantools wants each bit once
        for k in range(24):
            length = rng.randint(1, 64)
            bit = rng.randint(0, 8 * size - length)
            big = rng.random() < 0.6
            bits = {8 * (b // 8) + 7 - b % 8 if big else b for b in range(bit, bit + length)}
            if taken & bits:
                continue
            taken |= bits
            start = 8 * (bit // 8) + 7 - bit % 8 if big else bit
            signals.append(signal_of(f"S{k}", start, length, big=big, signed=rng.random() < 0.5, scale=0.25, offset=-3))
        layout = AnswerLayout(0x22, round_, message_of(0x22, round_, signals))
        answer = rng.randbytes(rng.randint(0, size))
        theirs = layout.message.decode(answer, allow_truncated=True, decode_choices=False)
        ours = decoded(layout, answer)
        assert set(ours) == set(theirs)
        for name, value in theirs.items():
            assert ours[name] == pytest.approx(float(value), rel=1e-12)


def test_the_standards_pids():
    """The standard's own examples and ends of scales."""
    pids = {layout.identifier: layout for layout in j1979()}
    for pid, data, name, value in (
        (0x05, "7b", "ECT", 83),
        (0x06, "80", "SHRTFT1", 0),
        (0x06, "00", "SHRTFT1", -100),
        (0x0C, "1af8", "RPM", 1726),
        (0x0D, "ff", "VSS", 255),
        (0x0E, "00", "SPARKADV", -64),
        (0x10, "ffff", "MAF", 655.35),
        (0x14, "5aff", "O2S11", 0.45),
        (0x22, "ffff", "FRP", 5177.265),
        (0x32, "8000", "EVAP_VP", -8192),
        (0x34, "80008000", "O2S11", 0),
        (0x3C, "ffff", "CATEMP11", 6513.5),
        (0x42, "3200", "VPWR", 12.8),
        (0x44, "8000", "EQ_RAT", 1),
        (0x5D, "6900", "FUEL_TIMING", 0),
        (0x5E, "ffff", "FUEL_RATE", 3276.75),
        (0xA6, "00012345", "ODO", 7456.5),
    ):
        assert decoded(pids[pid], bytes.fromhex(data))[name] == pytest.approx(value), (pid, name)
    state = decoded(pids[0x01], bytes.fromhex("83076504"))
    assert (state["MIL"], state["DTC_CNT"], state["CAT_SUP"], state["EVAP_SUP"], state["EVAP_RDY"]) == (1, 3, 1, 1, 1)


@pytest.mark.skipif(not OBDB.is_dir(), reason="OBDb's data are not there: GATEWAY_OBDB names a folder of its vehicles")
def test_the_standards_pids_are_those_of_other_readers():
    equal, differ, _ = judge("judge-j1979").judge(OBDB / "SAEJ1979", answers=20)
    assert equal["OBDb"] > 2500
    assert "" not in differ, differ[""]


def test_values_of_all_pids_and_results_of_monitors_are_those_that_scapy_reads():
    """By OBD on UDS here, and there of the same bytes in the classic form; of 10 others scapy has no layout.

    These have OBDb or python-OBD (``scripts/judge-j1979``): scapy has bytes, and of the air flow's two one.
    """
    module, pids = judge("judge-j1979"), {layout.identifier for layout in j1979()}
    found = [one for one in module.compared(defaultdict(list), 1, 75) if one.reader == "scapy"]
    other = [one for one in found if abs(one.ours - one.theirs) > module.NEAR_OF["scapy"]]
    assert [one for one in other if not module.reason(one, {})] == []
    assert pids - {one.pid for one in found} == {0x10, 0x8E, 0x9A, 0x9D, 0x9E, 0xA2, 0xA6, 0xB2, 0xD2, 0xD3}
    scalings, others = module.scapys_results(random.Random(75))
    assert (len(scalings), others) == (78, [])


def test_a_judge_of_the_standards_pids_sees_a_formula_that_differs(tmp_path):
    """The judge itself: of four formulas made here one adds what it should not, one breaks its own limits."""
    fmts = [
        (0x05, {"len": 8, "add": -41}),
        (0x06, {"len": 8, "mul": 100, "div": 128, "add": -128, "min": -100, "max": 99.2}),
    ]
    fmts += [(0x0C, {"len": 16, "div": 4}), (0x32, {"len": 16, "sign": True, "div": 4000, "unit": "kilopascal"})]
    commands = [{"cmd": {"01": f"{pid:02X}"}, "signals": [{"id": "X", "fmt": fmt}]} for pid, fmt in fmts]
    (tmp_path / "signalsets/v3").mkdir(parents=True)
    (tmp_path / "signalsets/v3/default.json").write_text(json.dumps({"commands": commands}))
    equal, differ, _ = judge("judge-j1979").judge(tmp_path, answers=1)
    assert equal["OBDb"] == 6
    assert {one.partition(": ")[2] for one in differ.pop("")} == {"05 ECT"}
    assert [why for why in differ if "OBDb" in why and differ[why] == {"06 SHRTFT1"}]


@pytest.mark.skipif(not OBDB.is_dir(), reason="OBDb's data are not there: GATEWAY_OBDB names a folder of its vehicles")
def test_recorded_answers_of_cars_have_the_values_that_obdb_expects():
    module = judge()
    standard = read_file(OBDB / "SAEJ1979/signalsets/v3/default.json").layouts
    for vehicle in sorted(path.parent for path in OBDB.glob("*/test_cases")):
        found = module.judge(vehicle, standard, most=2000)
        assert found.tried > 100
        assert found.equal >= 0.998 * found.total, found.counts


def test_a_judge_of_answers_sees_a_wrong_layout(tmp_path):
    """The judge itself, on a clone made here: one value of five is expected otherwise, one is of half an answer.

    Of a trim the file has another formula than the standard, which gives the value that is expected.
    """
    folder = tmp_path / "Car"
    (folder / "signalsets/v3").mkdir(parents=True)
    (folder / "signalsets/v3/default.json").write_text(signal_set())
    cases = folder / "tests/test_cases/2020/commands"
    cases.mkdir(parents=True)
    (cases / "7E4.7EC.220101.yaml").write_text(
        "command_id: 7E4.7EC.220101\ntest_cases:\n"
        "- response: |\n    7EC10086201012EE0C0\n    7EC2110000000000000\n"
        "  expected_values: {U: 12, MODE: run, T: 3}\n"
        "- {response: 7EC10086201012EE0C0, expected_values: {U: 12}}\n"
    )
    (cases / "7E0.0106.yaml").write_text("test_cases:\n- {response: 7E803410680, expected_values: {TRIM: 0}}\n")
    other = signal_of("TRIM", 7, 8, big=True, signed=False, scale=100 / 128, offset=-128, unit="%")
    found = judge().judge(folder, (AnswerLayout(0x01, 0x06, message_of(0x01, 0x06, [other])),))
    assert (found.tried, found.total, found.held, found.equal) == (3, 5, 4, 3)


def test_a_cdd_gives_its_identifiers(tmp_path):
    file = tmp_path / "ecu.cdd"
    file.write_text(CDD)
    found = read_file(file)
    (layout,) = found.layouts
    assert layout.name == "221234"
    assert decoded(layout, bytes.fromhex("fffe 0a")) == {"Torque": -1, "Level": 10}
    assert cantools.database.load_string(CDD, "cdd").dids[0].decode(bytes.fromhex("fffe0a61626364"))["Level"] == 10
    assert found.left_out[0].where.endswith("Text")


def test_a_folder_without_cases_is_not_judged(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["judge-obdb", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        judge().main()
    assert ended.value.code == 2
    assert f"{tmp_path}: no cases; expected is" in capsys.readouterr().err
