"""Databases as the community writes them: opendbc's are read with all that they have; what was put right is said."""

import re

import pytest

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway.signals.database import load_database
from gateway.signals.dialect import mended, text_of
from gateway_fdi.errors import InputError

DATABASES = pytest.importorskip("opendbc.dbc.generator.generator").generate_all()


@pytest.mark.parametrize("name", sorted(DATABASES))
def test_every_generated_database_of_opendbc_is_read_whole(name, tmp_path):
    file = tmp_path / f"{name}.dbc"
    file.write_text(DATABASES[name], encoding="cp1252", errors="replace")
    database = load_database([file])
    messages = re.findall(r"^BO_ (\d+) (\w+)", DATABASES[name], re.MULTILINE)
    assert {message.name for message in database} >= {
        text for _, text in messages if sum(other == text for _, other in messages) == 1
    }
    for message in database:
        assert message.is_extended_frame or message.frame_id <= 0x7FF


def test_what_is_put_right_is_said_and_nothing_else_is_touched():
    text = (
        'BO_ 419361024 Far: 8 A\n SG_ X : 0|8@1+ (.25,-.5) [0|.5] "" A\n'
        'CM_ SG_ 304 "of no signal";\nCM_ BO_ 419361024 "far .5";\nVAL_ 419361024 X 0 "off" ;\nVAL_ 7 Y 0 "gone" ;\n'
        'VAL_ 419361024 X 1 "on"\n'
    )
    made, said = mended(text)
    assert len(said) == 5
    assert made == (
        'BO_ 2566844672 Far: 8 A\n SG_ X : 0|8@1+ (0.25,-0.5) [0|0.5] "" A\n'
        'CM_ BO_ 2566844672 "far .5";\nVAL_ 2566844672 X 0 "off" ;\nVAL_ 2566844672 X 1 "on" ;\n'
    )
    assert mended(made) == (made, [])


def test_a_file_that_is_wrong_otherwise_has_the_error_that_it_had(tmp_path):
    file = tmp_path / "car.dbc"
    file.write_text('BO_ 1 M: 8 A\n SG_ X : 0|8@ what\nCM_ SG_ 304 "of no signal";\n')
    with pytest.raises(InputError) as told:
        load_database([file])
    assert told.value.line == 2


def test_names_that_begin_with_a_digit_and_identifiers_that_no_bus_has(tmp_path):
    """As in opendbc's psa_aee2010_r3, mazda_2017, toyota_2017_ref_pt and hyundai_kia_generic."""
    file = tmp_path / "car.dbc"
    file.write_text(
        'VERSION ""\nBS_:\nBU_: A\nBO_ 1275 2017_5: 8 A\n SG_ 0_COUNTER : 0|4@1+ (1,0) [0|15] "" A\n'
        'BO_ 1075054137 Gone: 8 A\n SG_ X : 0|8@1+ (1,0) [0|255] "" A\n'
        'CM_ 145 "no name";\nCM_ SG_ 1075054137 X "of the one that is gone";\nVAL_ 1275 0_COUNTER 0 "zero" ;\n'
    )
    database = load_database([file])
    assert [message.name for message in database] == ["_2017_5"]
    assert [signal.name for signal in database.message("_2017_5").signals] == ["_0_COUNTER"]


DBC = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 M: 8 A\n'
    ' SG_ X : 0|8@1+ (1,0) [0|255] "km/h" A\n SG_ Y : 8|8@1+ (1,0) [0|0] "" A\n'
)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('"km/h" A', '"km/h"', "receivers"),
        ('"" A\n', '""\n', "receivers"),  # the last line: cantools reads a message without its signal
        ('"km/h" A', '"km/h" A B', "receivers"),
        ('"km/h" A', '"km/h" A,', "receivers"),
        ('"km/h" A', '"km/h" 1A;', "receivers"),
        (' [0|255] "km/h" A', ' "km/h" A', "range"),
        (' "km/h" A', " A", "unit"),
        ("8 A\n", "8\n", "sender"),
        ("BO_ 256", "BO_ 0x100", "hexadecimal"),
        ("SG_ X", "SG_ T\u00fcr-1", "characters"),
        ("M:", "M.1:", "characters"),
        ("SG_ Y ", "SG_ Y M1 ", "branches"),
        ("A\n SG_ Y", 'A\n SG_ Z : 0|0@1+ (1,0) [0|0] "" A\n SG_ Y', "no bits"),
    ],
)
def test_lines_of_signals_that_depart_from_the_format_are_read(tmp_path, before, after, said, capsys):
    """A signal is never lost without a word (canmatrix#596 and others)."""
    text = DBC.replace("SG_ X", "SG_ X M") if "M1" in after else DBC
    assert before in text
    file = tmp_path / "car.dbc"
    file.write_bytes(text.replace(before, after, 1).encode("cp1252"))
    (message,) = load_database([file])
    assert [signal.start for signal in message.signals] == [0, 8]
    assert said in str(capsys.readouterr())


@pytest.mark.parametrize(
    "more",
    [
        'BA_DEF_ BO_ "Sendable" BOOL False True;\nBA_DEF_DEF_ "Sendable" False;\nBA_ "Sendable" BO_ 256 True;\n',
        'BA_ "GenMsgCycleTime" BO_ 256 100;\n',
        'BA_DEF_ BO_ "VFrameFormat" ENUM "1","2";\nBA_DEF_DEF_ "VFrameFormat" "1";\nBA_ "VFrameFormat" BO_ 256 9;\n',
        "VAL_ 256 X Table ;\n",
        "FOO_ 256 X 1;\nBAR_ 1 2\n3;\n",
    ],
)
def test_statements_that_say_nothing_of_bits_may_be_unreadable(tmp_path, more, capsys):
    file = tmp_path / "car.dbc"
    file.write_text(DBC + more + 'VAL_ 256 Y 0 "zero" ;\n')
    (message,) = load_database([file])
    assert [signal.name for signal in message.signals] == ["X", "Y"]
    assert message.signals[1].choices == {0: "zero"}
    assert "left out" in str(capsys.readouterr())


def test_a_statement_of_bits_that_cannot_be_read_refuses_the_file(tmp_path):
    file = tmp_path / "car.dbc"
    file.write_text(DBC + 'BO_ 257 N: 8 A\n SG_ Z : 0;8@1+ (1,0) [0|0] "" A\n')
    with pytest.raises(InputError) as told:
        load_database([file])
    assert (told.value.file, told.value.line) == (str(file), 9)


SYM = """FormatVersion=5.0 // Do not edit this line!
Title="car"

{ENUMS}
enum State(0="off",
  1="on")

{SENDRECEIVE}

[Branches]
ID=123h
DLC=8
Mux=Nine 0,8 9
Var=Nine value unsigned 8,8

[Branches]
DLC=8
Mux=Letter 0,8 a0h -m // as it came
Var=Other unsigned 8,8 /d:"text" /e:State

[Far]
ID=FF9B41h
DLC=2
Var=Z unsigned 0,8
"""


def test_sym_of_version_5_and_hexadecimal_numbers_that_begin_with_a_letter(tmp_path):
    """cantools#640, #611, canmatrix' test.sym."""
    file = tmp_path / "car.sym"
    file.write_text(SYM)
    database = load_database([file])
    branches, far = database.message("Branches"), database.message("Far")
    assert branches.decode(bytes([0xA0, 7, 0, 0, 0, 0, 0, 0]), decode_choices=False)["Other"] == 7
    assert branches.decode(bytes([9, 7, 0, 0, 0, 0, 0, 0]), decode_choices=False)["Nine value"] == 7
    assert (far.frame_id, far.is_extended_frame, far.length) == (0xFF9B41, True, 2)


def test_kcd_identifiers_of_29_bits_need_no_flag(tmp_path):
    file = tmp_path / "car.kcd"
    file.write_text(
        '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/><Bus name="B">'
        '<Message id="0x7FF" name="Near"><Signal name="A" offset="0" length="8"/></Message>'
        '<Message id="0xFF9B41" name="Far" length="8" format="standard">'
        '<Signal name="B" offset="0" length="8"/></Message>'
        "</Bus></NetworkDefinition>"
    )
    messages = {message.name: message for message in load_database([file])}
    assert not messages["Near"].is_extended_frame
    assert (messages["Far"].frame_id, messages["Far"].is_extended_frame) == (0xFF9B41, True)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_units_are_the_same_in_any_encoding(tmp_path, encoding):
    """cantools#478: UTF-8 read as Windows-1252 makes two characters of the degree sign."""
    file = tmp_path / "car.dbc"
    file.write_bytes(DBC.replace("km/h", "\u00b0C").encode(encoding))
    (message,) = load_database([file])
    assert message.signals[0].unit == "\u00b0C"


def test_an_xml_file_says_its_encoding():
    text = '<?xml version="1.0" encoding="iso-8859-15"?><a u="\u20ac"/>'
    assert text_of(text.encode("iso-8859-15")) == text
    assert text_of(text.replace("iso-8859-15", "utf-8").encode()).endswith('u="\u20ac"/>')
    assert text_of(b'<?xml version="1.0" encoding="nonsense"?>\xb0').endswith("\u00b0")


def test_a_rule_takes_units_of_files_in_different_encodings(tmp_path):
    names = ("utf-8", "utf-8-sig", "cp1252")
    for k, encoding in enumerate(names):
        text = DBC.replace("km/h", "\u00b0C").replace("256 M", f"{256 + k} M{k}")
        (tmp_path / f"{encoding}.dbc").write_bytes(text.encode(encoding))
    (tmp_path / "car.toml").write_text(
        f'name = "car"\n[[bus]]\nname = "b"\nuri = "virtual:b"\ndatabase = {[f"{name}.dbc" for name in names]}\n'
        '[[monitor]]\nname = "m"\ntype = "rule"\nbus = "b"\n'
        'rule = [{ name = "alike", holds = "abs(M0.X - max(M1.X, M2.X)) < 5" }]\n'
    )
    Gateway(load_config(tmp_path / "car.toml")).close()


def test_a_range_of_32_bits_is_decoded(tmp_path):
    file = tmp_path / "car.dbc"
    file.write_text(
        DBC.replace("SG_ X : 0|8", "SG_ X M : 0|32").replace("SG_ Y : 8", "SG_ Y m0 : 32")
        + "SG_MUL_VAL_ 256 Y X 0-4294967295;\n"
    )
    (message,) = load_database([file])
    assert message.decode(bytes([1, 2, 3, 4, 5, 0, 0, 0]), decode_choices=False) == {"X": 0x04030201, "Y": 5}
