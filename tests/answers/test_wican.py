"""Vehicle profiles of WiCAN: expressions over the bytes of frames, addresses from an adapter's commands."""

import json
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import pytest

from gateway.bus.frames import EXTENDED
from gateway.config.load import load_config
from gateway_ask.answers.decode import AnswerDecoder
from gateway_ask.answers.layout import Address, read_file
from gateway_ask.cli.import_layouts import import_layouts
from gateway_fdi.errors import InputError

SCRIPT = Path(__file__).parents[2] / "scripts/judge-wican"


def judge():
    """Return the script as a module."""
    spec = spec_from_loader("judge_wican", SourceFileLoader("judge_wican", str(SCRIPT)))
    module = sys.modules["judge_wican"] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def profile(*pids, **more):
    return {"car_model": "Make: Model", "init": "ATSP6;ATSH7E4;ATST96;", "pids": list(pids), **more}


def written(folder, document, name="car.json"):
    (folder / "make").mkdir(exist_ok=True)
    file = folder / "make" / name
    file.write_text(json.dumps(document))
    return file


#: Requests with expressions: one frame, several frames by their bytes, by a digit behind the request.
ENTRIES = [
    {
        "pid": "2201019",
        "parameters": {
            "BYTE": "B10/2", "WORD": "[B11:B12]*0.1-40", "BIT": "B9:3", "SIGNED": "(S13)", "WORDS": "[S13:S14]/100",
            "ACROSS": "((B15<<8)+B17)/100", "BEFORE": "1*(((B39*16777216)+[B41:B43])/10)", "LOW": "(B18&15)*2",
            "HIGH": "B19>>4", "LESS": "(65536-[B20:B21])/10", "TURNED": "B22+(B23*256)", "ZERO": "([B25:B27]>>4)*0.75",
        },
    },
    {"pid": "2101", "pid_init": "ATSHDA10F1;ATCRA18DAF110;ATH0;", "parameters": {"ONE": "B3-50", "TWO": "[B4:B5]"}},
    {"pid": "015B2", "pid_init": "ATSH7DF;", "parameters": [{"name": "SOC", "expression": "B3/2.55", "unit": "%"}]},
]  # fmt: skip
#: Others, each with what is said of it.
NONE = {
    "[B10:B11]*B12": "multiplies", "B16+1": "no byte", "B1": "not of the answer's data", "B10+B11": "not one number",
    "(B63<<8)+B35": "do not follow each other", "B10/0": "divides by 0", "B10^3": "operator",
    "B10>>999999999": "more than 64 bits", "[B15:B17]": "not one number",
    "sin(B10)": "no expression", "B10.real": "no expression", "[B10:B40]": "31 bytes", "B10**2": "operator",
    "(B10-1)&3": "shifts or masks", "[B10:S11]": "two kinds", "": "no expression", "B10*9**9**9": "operator",
}  # fmt: skip


def test_expressions_are_what_an_adapter_calculates(tmp_path):
    file = written(tmp_path, profile(*ENTRIES))
    found = read_file(file)
    assert found.left_out == ()
    assert [one.address for one in found.layouts] == [
        Address(0x7E4, None),
        Address(0x18DA10F1 | EXTENDED, 0x18DAF110 | EXTENDED),
        None,
    ]
    script = judge()
    car = profile(*[
        each | {"parameters": [{"name": n, "expression": e} for n, e in each["parameters"].items()]}
        if isinstance(each["parameters"], dict) else each for each in ENTRIES
    ])  # fmt: skip
    counts, wrong = script.judge(file, car, script.random.Random(75), 10)
    assert (counts["equal"], wrong) == (150, [])
    car["pids"][0]["parameters"][0]["expression"] = "B10/3"  # the judge itself
    assert len(script.judge(file, car, script.random.Random(75), 10)[1]) > 5


def test_what_is_not_one_number_is_left_out_with_the_reason(tmp_path):
    names = {f"X{k}": text for k, text in enumerate(NONE)}
    found = read_file(written(tmp_path, profile({"pid": "2201019", "parameters": {"OK": "B10", **names}})))
    assert [signal.name for signal in found.layouts[0].message.signals] == ["OK"]
    told = dict(zip(NONE, found.left_out, strict=True))
    for text, said in NONE.items():
        assert said in told[text].why, text
        assert told[text].where.startswith("pids[0] 2201019 X")


def test_a_profile_has_what_it_extends_but_for_what_it_changes(tmp_path):
    written(tmp_path, profile({"pid": "220101", "parameters": {"A": "B9", "B": "B10", "C": "B11"}}), "base.json")
    more = [{"pid": "remove", "parameters": {"A": ""}}, {"pid": "220102", "parameters": {"B": "B12/2"}}]
    found = read_file(written(tmp_path, profile(*more, init="ATSH7C6;", extends="make/base.json")))
    assert {one.name: [s.name for s in one.message.signals] for one in found.layouts} == {
        "220101": ["C"],
        "220102": ["B"],
    }
    assert {one.address.request for one in found.layouts} == {0x7C6}
    assert read_file(written(tmp_path, {"cars": [profile(ENTRIES[1])]})).layouts[0].name == "2101"


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"cars": [profile(), profile()]}, "cars = '2 cars'"),
        (profile(extends="make/none.json"), "extends = 'make/none.json'"),
        (profile(extends="make/car.json"), "extends"),
        (profile({"pid": "22XX", "parameters": {}}), "pids[0].pid = '22XX'"),
        (profile({"pid": "220101", "parameters": {"a b": "B1"}}), "pids[0].parameters.a b"),
        (profile({"pid": "220101", "parameters": {"A": 5}}), "pids[0].parameters.A = 5"),
        (profile({"pid": "220101", "pid_init": "ATSH7EX;", "parameters": {"A": "B9"}}), "pids[0].pid_init"),
        (profile({"pid": "221E3B1E3D", "parameters": {"A": "B9"}}), "one identifier"),
        (profile({"pid": "220101", "parameters": {"A": "B9"}}, init="ATCEA07;ATSH6F1;"), "pids[0] 220101"),
        (profile(init=5), "init = 5"),
        (profile(pids={}), "pids"),
        (profile(), "no requests"),
    ],
)
def test_what_cannot_be_read_is_refused_with_file_key_and_reason(tmp_path, document, said):
    with pytest.raises(InputError) as caught:
        read_file(written(tmp_path, document))
    assert said in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_a_profile_is_imported_as_a_configuration_that_asks(tmp_path, capsys):
    file, out = written(tmp_path, profile(*ENTRIES)), tmp_path / "ecu.toml"
    options = {"request": None, "response": None, "year": None, "force": False, "json": False}
    assert import_layouts(file, out=out, bus="obd=virtual:x", **options) == 0
    ecus = {ecu.request or ecu.address: [read.key for read in ecu.read] for ecu in load_config(out).ecu}
    assert ecus == {0x7E4: [(0x22, 0x0101)], 0x10: [(0x21, 0x01)], 0x7E0: [(0x01, 0x5B)]}
    assert "7E4: response 7EC" in capsys.readouterr().out
    with pytest.raises(InputError, match="model years"):
        import_layouts(file, out=out, bus="obd=virtual:x", **options | {"year": 2024, "force": True})


def test_values_are_decoded(tmp_path):
    layout = read_file(written(tmp_path, profile(*ENTRIES))).layouts[0]
    data = bytes(range(40))
    found = AnswerDecoder(layout).decode([data])
    values = {name: float(found.values[k, 0]) for k, name in enumerate(found.names)}
    # B10 is the second byte of the second frame: byte 7 of the answer behind its length, 4 of its data.
    assert values["BYTE"] == 4 / 2
    assert values["WORD"] == pytest.approx(0x0506 * 0.1 - 40)
    assert values["ACROSS"] == pytest.approx(0x090A / 100)
