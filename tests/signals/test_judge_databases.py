"""scripts/judge-databases finds what differs from cantools, and says what is known."""

import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 Plain: 8 A
 SG_ X : 7|12@0- (0.5,3) [0|0] "" A
 SG_ F : 32|32@1- (1,0) [0|0] "" A
BO_ 257 Branches: 4 A
 SG_ Mux M : 0|2@1+ (1,0) [0|0] "" A
 SG_ One m1 : 8|16@1+ (1,0) [0|0] "" A
 SG_ Two m2 : 8|8@1+ (1,0) [0|0] "" A
BO_ 258 Short: 2 A
 SG_ In : 0|8@1+ (1,0) [0|0] "" A
 SG_ Out : 12|8@1+ (1,0) [0|0] "" A
SIG_VALTYPE_ 256 F : 1;
"""


@pytest.fixture
def judge(monkeypatch, tmp_path, capsys):
    """The script as a module, run on a folder with a database and a file that is none."""
    loader = SourceFileLoader("judge_databases", str(ROOT / "scripts/judge-databases"))
    module = module_from_spec(spec_from_loader("judge_databases", loader))
    monkeypatch.setitem(sys.modules, "judge_databases", module)
    loader.exec_module(module)
    (tmp_path / "car.dbc").write_text(DBC)
    (tmp_path / "none.dbc").write_text("BO_ what\n")
    monkeypatch.setattr(sys, "argv", ["judge-databases", str(tmp_path), "--frames", "40", "--seed", "3"])

    def run():
        code = module.main()
        return code, capsys.readouterr().out

    run.module = module
    return run


def test_what_is_equal_or_known_is_no_difference(judge):
    code, out = judge()
    assert code == 0, out
    assert "seed 3" in out
    assert "1 read, 1 refused, 0 crashed" in out
    assert "none.dbc:1" in out
    assert "a multiplexer value of no branch" in out
    assert "a signal beyond its message" in out


@pytest.mark.parametrize("what", ["value", "presence", "crash"])
def test_what_is_wrong_is_shown(judge, monkeypatch, what):
    right = judge.module.decode_columns

    def wrong(frames, plan, row):
        found = right(frames, plan, row)
        if what == "value":
            found.values[0] += 1.0
        if what == "presence":
            found.there[0] = False
        if what == "crash":
            raise KeyError("a bug")
        return found

    monkeypatch.setattr(judge.module, "decode_columns", wrong)
    code, out = judge()
    assert code == 1
    assert {"value": "another value", "presence": "missing", "crash": "CRASH"}[what] in out
